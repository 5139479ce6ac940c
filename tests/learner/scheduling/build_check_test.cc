#include "learner/scheduling/build_check.h"

#include <string>

#include <absl/strings/str_cat.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "learner/service/worker_page.h"
#include "tests/fakes/fake_clock.h"
#include "tests/fakes/status_matchers.h"
#include "tests/learner/scheduling/test_registry.h"

namespace craftfleet {
namespace build_check_test {

using testing::AllOf;
using testing::HasSubstr;

// A registry in which the actor "known" plays, and its status page.
class Check {
 public:
  Check(const BuildCheck::Options& build, Clock* clock) : registry_(Options(build), clock) {}

  absl::Status CheckActor(const std::string& name, const std::string& canary, const std::string& build = "0.2") {
    return static_cast<WorkerRegistry&>(registry_).Join({}, name, "", {build, canary, "a CPU, AVX512"});
  }
  absl::Status CheckServer(const std::string& name, const std::string& canary) {
    return registry_.Announce({}, name, name + ":1", 0, {"0.2", canary});
  }
  std::string GameCanary() const { return registry_.builds()->GameCanary(); }
  v1::StatusReply Status() const {
    v1::StatusReply reply;
    AddWorkers(registry_, &reply);
    return reply;
  }
  // The state of the worker with that name; "": it is not shown.
  std::string StateOf(const std::string& name) const {
    const v1::StatusReply reply = Status();
    for (const v1::Peer& peer : reply.peers()) {
      if (peer.name() == name) return peer.state();
    }
    return "";
  }

 private:
  static WorkerRegistry::Options Options(const BuildCheck::Options& build) {
    WorkerRegistry::Options options;
    options.lanes.lanes = 1;
    options.build = build;
    return options;
  }

  TestRegistry registry_;
};

TEST(BuildCheck, AWorkerThatDiffersIsRefusedAndLogged) {
  FakeClock clock;
  Check check({"0.2", "cafe", "game", false}, &clock);
  EXPECT_THAT(check.CheckActor("a", "cafe"), IsOk());
  EXPECT_THAT(check.CheckActor("b", "dead", "0.1 (abc)"),
              StatusIs(absl::StatusCode::kFailedPrecondition,
                       AllOf(HasSubstr("actor b (build 0.1 (abc)) computes different results"),
                             HasSubstr("a CPU, AVX512"), HasSubstr("its canary is dead"), Not(HasSubstr("cafe")),
                             HasSubstr("--cpu=avx2"), HasSubstr("--allow_mixed"))));
  EXPECT_THAT(check.CheckActor("old", "", ""),
              StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("build older than this one")));
  EXPECT_THAT(check.CheckServer("s", "other"),
              StatusIs(absl::StatusCode::kFailedPrecondition,
                       AllOf(HasSubstr("environment server s"), HasSubstr("plays another game"))));
  const v1::StatusReply reply = check.Status();
  ASSERT_EQ(reply.peers_size(), 4);
  EXPECT_EQ(check.StateOf("a"), "0 permits, 0 fragments accepted");
  EXPECT_EQ(reply.peers(1).name(), "b");
  EXPECT_EQ(reply.peers(1).state(), "refused: another canary, build 0.1 (abc)");
  EXPECT_EQ(reply.peers(1).health(), v1::Peer::LOST);
  EXPECT_EQ(reply.peers(3).role(), "envserver");
  EXPECT_EQ(reply.metrics(0).name(), "workers_mixed");
  EXPECT_EQ(reply.metrics(0).value(), 3);

  EXPECT_THAT(check.CheckActor("b", "cafe"), IsOk()) << "it was upgraded";
  EXPECT_EQ(check.StateOf("b"), "0 permits, 0 fragments accepted");
  clock.Advance(WorkerTable::kRememberLost + absl::Seconds(1));
  EXPECT_EQ(check.Status().peers_size(), 0);
}

TEST(BuildCheck, WithAllowMixedItIsAcceptedAndLogged) {
  FakeClock clock;
  Check check({"0.2", "cafe", "game", true}, &clock);
  testing::internal::CaptureStderr();
  EXPECT_THAT(check.CheckActor("known", "dead", "0.1"), IsOk());
  EXPECT_THAT(check.CheckActor("x", "dead", "0.1"), IsOk());
  const std::string log = testing::internal::GetCapturedStderr();
  EXPECT_THAT(log, HasSubstr("actor known (build 0.1) computes different results"));
  EXPECT_EQ(log.find("actor x"), std::string::npos) << "a warning for each build, not for each worker";
  EXPECT_EQ(check.StateOf("known"), "0 permits, 0 fragments accepted; mixed: another canary, build 0.1");
  EXPECT_EQ(check.GameCanary(), "") << "actors accept any server";
}

TEST(BuildCheck, RemembersTheNewestAndShowsPrintableText) {
  FakeClock clock;
  Check check({"0.2", "cafe", "game", false}, &clock);
  for (int i = 0; i < 100; ++i) {
    clock.Advance(absl::Milliseconds(1));
    const absl::Status status = check.CheckActor(absl::StrCat("a", i), std::string(500, '\n'), "\x1b[31m");
    EXPECT_EQ(status.message().find_first_of("\n\x1b"), absl::string_view::npos);
    EXPECT_LT(status.message().size(), 1024);
  }
  EXPECT_EQ(check.Status().peers_size(), static_cast<int>(WorkerTable::kMaxRefused));
}

}  // namespace build_check_test
}  // namespace craftfleet
