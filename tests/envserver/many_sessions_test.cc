// EnvServiceImpl: sessions beside each other.
#include <sys/resource.h>
#include <unistd.h>

#include <atomic>
#include <fstream>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/io/paths.h"
#include "common/wire/channel.h"
#include "common/wire/server.h"
#include "envserver/env_service.h"
#include "tests/envserver/full_game.h"
#include "tests/envserver/test_session.h"
#include "tests/fakes/played_game.h"
#include "tests/fakes/sanitizers.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/threads.h"
#include "tests/fakes/wait_until.h"

namespace craftfleet {
namespace {

using testing::AllOf;
using testing::HasSubstr;

// An exception ends only its session, with an error after which its fragments are played again. Here there is too
// little memory for the pictures of 4096 games.
TEST_F(EnvServiceTest, AnExceptionEndsOnlyItsSession) {
  if (kAddressSanitizer) GTEST_SKIP() << "AddressSanitizer needs address space without a limit";
  Witness witness(server());
  Session session(server());
  v1::PlayRequest hello = Hello("run-a");
  hello.mutable_hello()->mutable_env()->set_frame_size(1024);
  ASSERT_THAT(session.Send(hello), IsOk());
  rlimit before{};
  ASSERT_EQ(getrlimit(RLIMIT_AS, &before), 0);
  rlim_t pages = 0;  // some GiB where many threads have stacks and arenas
  std::ifstream("/proc/self/statm") >> pages;
  const rlimit limit = {pages * sysconf(_SC_PAGESIZE) + (3UL << 30), before.rlim_max};
  ASSERT_EQ(setrlimit(RLIMIT_AS, &limit), 0);
  const absl::Status status = session.Send(OpenMany(EnvBatch::kMaxLanes)).status();
  ASSERT_EQ(setrlimit(RLIMIT_AS, &before), 0);
  EXPECT_THAT(status,
              StatusIs(absl::StatusCode::kAborted, AllOf(HasSubstr("the environment failed"), HasSubstr("bad_alloc"))));
  witness.PlayOn(10);
}

// It used to keep the room of its games for --idle_timeout, ten minutes.
TEST(EnvService, AnIdleSessionGivesWayToOneThatNeedsItsRoom) {
  EnvServiceImpl::Options options;
  options.budget.games = 1;
  options.budget.session_games = 1;
  options.gives_way = absl::ZeroDuration();
  const auto service = *EnvServiceImpl::Create(*DefaultTextureDir(), options);
  const auto server = *wire::Server::Create({}, {service.get()});
  Session idle(server->InProcess());
  ASSERT_THAT(idle.Send(Hello("run-a")), IsOk());
  ASSERT_THAT(idle.Send(Open(0, 1)), IsOk());
  EXPECT_TRUE(WaitUntil([&] {
    Session session(server->InProcess());
    return session.Send(Hello("run-a")).ok() && session.Send(Open(0, 1)).ok();
  }));
  EXPECT_THAT(idle.Send(Open(0, 1)),
              StatusIs(absl::StatusCode::kResourceExhausted, HasSubstr("this session sent nothing")));
}

// It has tables for them, and no game.
TEST(EnvService, AnIdleSessionWithLargePicturesGivesWay) {
  EnvServiceImpl::Options options;
  options.budget.session_bytes = 20 << 20;
  options.budget.bytes = 20 << 20;
  options.gives_way = absl::ZeroDuration();
  const auto service = *EnvServiceImpl::Create(*DefaultTextureDir(), options);
  const auto server = *wire::Server::Create({}, {service.get()});
  v1::PlayRequest hello = Hello("run-a");
  hello.mutable_hello()->mutable_env()->set_frame_size(700);
  Session idle(server->InProcess());
  ASSERT_THAT(idle.Send(hello), IsOk());
  EXPECT_TRUE(WaitUntil([&] { return Session(server->InProcess()).Send(hello).ok(); }));
}

// Each open one was counted twice then.
TEST(EnvService, ASessionWithAllItsGamesMayStartThemAnew) {
  EnvServiceImpl::Options options;
  options.budget.session_games = 2;
  const auto service = *EnvServiceImpl::Create(*DefaultTextureDir(), options);
  const auto server = *wire::Server::Create({}, {service.get()});
  Session session(server->InProcess());
  ASSERT_THAT(session.Send(Hello("run-a")), IsOk());
  ASSERT_THAT(session.Send(OpenMany(2)), IsOk());
  EXPECT_THAT(session.Send(OpenMany(2)), IsOk());
  EXPECT_THAT(session.Send(Open(1, 5)), IsOk());
  EXPECT_THAT(session.Send(Open(2, 5)), StatusIs(absl::StatusCode::kResourceExhausted,
                                                 HasSubstr("3 requested, at most 2 (--max_session_games)")));
}

// 64 KiB were counted for each game, whatever its snapshot held.
TEST(EnvService, GamesWithManyObjectsTakeMoreOfTheBudget) {
  const std::string full = FullSnapshot(MakeRenderer(kLength));
  EnvServiceImpl::Options options;
  options.budget.session_bytes = 4 << 20;
  const auto service = *EnvServiceImpl::Create(*DefaultTextureDir(), options);
  const auto server = *wire::Server::Create({}, {service.get()});
  const auto open = [&](const std::string& snapshot) {
    Session session(server->InProcess());
    EXPECT_THAT(session.Send(Hello("")), IsOk());
    v1::PlayRequest request;
    for (int lane = 0; lane < 16; ++lane) request.mutable_open()->MergeFrom(Open(lane, lane, snapshot).open());
    return session.Send(request).status();
  };
  EXPECT_THAT(open(""), IsOk());
  EXPECT_THAT(open(full), StatusIs(absl::StatusCode::kResourceExhausted, HasSubstr("--max_session_mb")));
}

// Each used to have a thread for as long as it was open.
TEST_F(EnvServiceTest, ManySessionsHaveNoThreadsOfTheirOwn) {
  constexpr int kSessions = 300;
  Witness witness(server());
  const int before = CountThreads();
  std::vector<std::unique_ptr<Session>> sessions;
  for (int i = 0; i < kSessions; ++i) {
    sessions.push_back(std::make_unique<Session>(server()));
    ASSERT_THAT(sessions.back()->Send(Hello("run-a")), IsOk());
    ASSERT_THAT(sessions.back()->Send(Open(i, i)), IsOk());
  }
  for (int i = 0; i < kSessions; ++i) ASSERT_THAT(sessions[i]->Send(Step({i}, "\x02")), IsOk());
  EXPECT_LT(CountThreads(), before + 20);
  EXPECT_EQ(Status().peers_size(), kSessions + 1);
  witness.PlayOn(5);
}

TEST_F(EnvServiceTest, RequestsSentAheadAreAnsweredInTheirOrder) {
  Session session(server());
  ASSERT_THAT(session.Send(Hello("run-a")), IsOk());
  ASSERT_THAT(session.Send(Open(0, 5)), IsOk());
  const auto listening = *wire::Server::Create({"127.0.0.1:0"}, {service_.get()});  // sockets keep what is sent ahead
  Session ahead(wire::Connect(listening->address()));
  ASSERT_THAT(ahead.Send(Hello("run-a")), IsOk());
  ahead.Write(Open(0, 5));
  for (char action = 1; action < 6; ++action) ahead.Write(Step({0}, std::string(1, action)));
  ASSERT_THAT(ahead.Read(), IsOk());
  for (char action = 1; action < 6; ++action) {
    const auto reply = ahead.Read();
    ASSERT_THAT(reply, IsOk());
    EXPECT_EQ(reply->frames(), session.Send(Step({0}, std::string(1, action)))->frames()) << int{action};
  }
}

// A single thread for games, and a session that another one must not hold up.
class OneGameThreadTest : public testing::Test {
 protected:
  static EnvServiceImpl::Options Options() {
    EnvServiceImpl::Options options;
    options.game_threads = 1;
    return options;
  }

  const std::unique_ptr<EnvServiceImpl> service_ = *EnvServiceImpl::Create(*DefaultTextureDir(), Options());
  const std::unique_ptr<wire::Server> server_ = *wire::Server::Create({}, {service_.get()});
  Witness witness_{server_->InProcess()};
  Session session_{server_->InProcess()};
};

// Opening as many games takes a second and more. They used to share the cores by having a thread each.
TEST_F(OneGameThreadTest, ALongRequestLetsOtherSessionsPlay) {
  ASSERT_THAT(session_.Send(Hello("run-a")), IsOk());
  const double memory = Metric(*service_, "games_memory");
  session_.Write(OpenMany(EnvBatch::kMaxLanes));
  ASSERT_TRUE(WaitUntil([&] { return Metric(*service_, "games_memory") > memory; })) << "it has begun";
  witness_.PlayOn(10);
  v1::StatusReply status;
  service_->FillStatus(&status);
  EXPECT_EQ(status.summary().lanes(), 1) << "only the witness has its reply";
  EXPECT_THAT(session_.Read(), IsOk());
}

// A step of such a game takes some 50 ms. They used to have a thread each, between which the system divided the cores.
TEST_F(OneGameThreadTest, LargePicturesDoNotDelayOtherSessions) {
  v1::PlayRequest hello = Hello("run-a");
  hello.mutable_hello()->mutable_env()->set_frame_size(2048);
  ASSERT_THAT(session_.Send(hello), IsOk());
  ASSERT_THAT(session_.Send(Open(0, 1)), IsOk());
  std::atomic<int> steps{0};
  std::atomic<bool> enough{false};
  std::thread player([&] {
    while (!enough && session_.Send(Step({0}, "\x02")).ok()) ++steps;
  });
  EXPECT_TRUE(WaitUntil([&] { return steps > 0; }));
  const int before = steps;
  witness_.PlayOn(20);
  EXPECT_LT(steps - before, 10) << "they took turns";
  enough = true;
  player.join();
}

}  // namespace
}  // namespace craftfleet
