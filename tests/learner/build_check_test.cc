#include "learner/build_check.h"

#include <string>

#include <absl/strings/str_cat.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/fakes/fake_clock.h"
#include "tests/fakes/status_matchers.h"

namespace craftfleet {
namespace {

using testing::AllOf;
using testing::HasSubstr;

v1::JoinRequest Actor(const std::string& name, const std::string& canary, const std::string& build = "0.2") {
  v1::JoinRequest request;
  request.set_actor(name);
  request.set_canary(canary);
  request.set_build(build);
  request.set_cpu("a CPU, AVX512");
  return request;
}

v1::Announcement Server(const std::string& name, const std::string& canary, const std::string& build = "0.2") {
  v1::Announcement announcement;
  announcement.set_name(name);
  announcement.set_canary(canary);
  announcement.set_build(build);
  return announcement;
}

// What a status page says with `check`, where "known" plays.
v1::StatusReply StatusOf(const BuildCheck& check) {
  v1::StatusReply reply;
  v1::Peer* known = reply.add_peers();
  known->set_role("actor");
  known->set_name("known");
  known->set_state("2 permits");
  check.FillStatus(&reply);
  return reply;
}

TEST(BuildCheck, WhoComputesOtherNumbersIsRefusedAndNamed) {
  FakeClock clock;
  BuildCheck check({"0.2", "cafe", "game", false}, &clock);
  EXPECT_THAT(check.CheckActor(Actor("a", "cafe")), IsOk());
  EXPECT_THAT(
      check.CheckActor(Actor("b", "dead", "0.1 (abc)")),
      StatusIs(absl::StatusCode::kFailedPrecondition,
               AllOf(HasSubstr("actor b (build 0.1 (abc)) computes other numbers"), HasSubstr("a CPU, AVX512"),
                     HasSubstr("its canary is dead, want cafe"), HasSubstr("--cpu=avx2"), HasSubstr("--allow_mixed"))));
  EXPECT_THAT(check.CheckActor(Actor("old", "", "")),
              StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("build older than this one")));
  EXPECT_THAT(check.CheckServer(Server("s", "other")),
              StatusIs(absl::StatusCode::kFailedPrecondition,
                       AllOf(HasSubstr("environment server s"), HasSubstr("plays another game"))));
  const v1::StatusReply reply = StatusOf(check);
  ASSERT_EQ(reply.peers_size(), 4);
  EXPECT_EQ(reply.peers(0).state(), "2 permits");
  EXPECT_EQ(reply.peers(1).name(), "b");
  EXPECT_EQ(reply.peers(1).state(), "refused: another canary, build 0.1 (abc)");
  EXPECT_EQ(reply.peers(1).health(), v1::Peer::LOST);
  EXPECT_EQ(reply.peers(3).role(), "envserver");
  EXPECT_EQ(reply.metrics(0).name(), "workers_mixed");
  EXPECT_EQ(reply.metrics(0).value(), 3);

  EXPECT_THAT(check.CheckActor(Actor("b", "cafe")), IsOk()) << "it was upgraded";
  EXPECT_EQ(StatusOf(check).peers_size(), 3);
  clock.Advance(BuildCheck::kRemember + absl::Seconds(1));
  EXPECT_EQ(StatusOf(check).peers_size(), 1);
}

TEST(BuildCheck, WithAllowMixedItIsLetInAndNamed) {
  FakeClock clock;
  BuildCheck check({"0.2", "cafe", "game", true}, &clock);
  testing::internal::CaptureStderr();
  EXPECT_THAT(check.CheckActor(Actor("known", "dead", "0.1")), IsOk());
  EXPECT_THAT(check.CheckActor(Actor("x", "dead", "0.1")), IsOk());
  const std::string log = testing::internal::GetCapturedStderr();
  EXPECT_THAT(log, HasSubstr("actor known (build 0.1) computes other numbers"));
  EXPECT_EQ(log.find("actor x"), std::string::npos) << "a warning for each build, not for each worker";
  EXPECT_EQ(StatusOf(check).peers(0).state(), "2 permits; mixed: another canary, build 0.1");
  EXPECT_EQ(check.GameCanary(), "") << "actors take any server";
}

TEST(BuildCheck, ServersWithTexturesOfTheirOwnAreComparedWithTheFirst) {
  FakeClock clock;
  BuildCheck check({"0.2", "cafe", "", false}, &clock);
  EXPECT_EQ(check.GameCanary(), "");
  EXPECT_THAT(check.CheckServer(Server("a", "game")), IsOk());
  EXPECT_EQ(check.GameCanary(), "game");
  EXPECT_THAT(check.CheckServer(Server("b", "game")), IsOk());
  EXPECT_THAT(check.CheckServer(Server("c", "other")),
              StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("another game than the first one")));
}

TEST(BuildCheck, RemembersSomeAndShowsWhatIsFitForATerminal) {
  FakeClock clock;
  BuildCheck check({"0.2", "cafe", "game", false}, &clock);
  for (int i = 0; i < 100; ++i) {
    clock.Advance(absl::Milliseconds(1));
    const absl::Status status = check.CheckActor(Actor(absl::StrCat("a", i), std::string(500, '\n'), "\x1b[31m"));
    EXPECT_EQ(status.message().find_first_of("\n\x1b"), absl::string_view::npos);
    EXPECT_LT(status.message().size(), 1024);
  }
  EXPECT_EQ(StatusOf(check).peers_size(), 1 + static_cast<int>(BuildCheck::kMaxRemembered));
}

}  // namespace
}  // namespace craftfleet
