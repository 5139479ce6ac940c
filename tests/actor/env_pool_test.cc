#include "actor/env_pool.h"

#include <sys/resource.h>

#include <algorithm>
#include <iterator>
#include <map>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <absl/strings/match.h>
#include <absl/time/clock.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/telemetry/process_usage.h"
#include "tests/fakes/env_server.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/temp_folder.h"
#include "tests/fakes/wait_until.h"

namespace craftfleet {
namespace env_pool_test {

using testing::AllOf;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::SizeIs;

constexpr int kFrameBytes = 64 * 64 * 3;
constexpr int kLength = 50;  // of an episode

std::vector<EnvClient::Lane> NewLanes(const std::vector<int>& lanes) {
  std::vector<EnvClient::Lane> open;
  open.reserve(lanes.size());
  for (const int lane : lanes) open.push_back({lane, lane + 100, 1, ""});
  return open;
}

// The observed course of some lanes' games, independent of the servers that run them.
struct Seen {
  // Steps every lane once, with actions that depend only on lane and step.
  absl::Status Step(EnvPool* pool, bool snapshot = false) {
    std::vector<int> lanes;
    for (const auto& [lane, frame] : frames) lanes.push_back(lane);
    lanes = pool->Arrange(lanes);
    std::vector<Action> actions;
    actions.reserve(lanes.size());
    for (const int lane : lanes) actions.push_back(static_cast<Action>((lane * 3 + steps * 5) % kNumActions));
    const absl::StatusOr<EnvPool::Stepped> stepped = pool->Step(lanes, actions, snapshot);
    if (!stepped.ok()) return stepped.status();
    ++steps;
    lost = stepped->lost;
    for (const int lane : lost) {
      lanes.erase(std::remove(lanes.begin(), lanes.end(), lane), lanes.end());
      frames.erase(lane);
    }
    EXPECT_EQ(stepped->lanes.size(), lanes.size());
    EXPECT_EQ(stepped->frames.size(), lanes.size() * kFrameBytes);
    for (size_t row = 0; row < lanes.size(); ++row) {
      const EnvPool::SteppedLane& lane = stepped->lanes[row];
      EXPECT_EQ(lane.lane, lanes[row]);
      frames[lanes[row]] = stepped->frames.substr(row * kFrameBytes, kFrameBytes);
      rewards[lanes[row]] += lane.reward;
      EXPECT_EQ(lane.snapshot.empty(), !snapshot);
      if (snapshot) snapshots[lanes[row]] = lane.snapshot;
      // All episodes are truncated: they are too short for a death.
      EXPECT_EQ(lane.last_frame.size(), lane.end == StepEnd::kNone ? 0 : kFrameBytes);
      EXPECT_EQ(lane.episode.length, lane.end == StepEnd::kNone ? 0 : kLength);
      episodes += lane.end == StepEnd::kNone ? 0 : 1;
    }
    return absl::OkStatus();
  }
  absl::Status Open(EnvPool* pool, const std::vector<EnvClient::Lane>& lanes) {
    const absl::StatusOr<EnvPool::Opened> opened = pool->Open(lanes);
    if (!opened.ok()) return opened.status();
    lost = opened->lost;
    EXPECT_EQ(opened->lanes.size(), lanes.size());
    for (size_t i = 0; i < lanes.size(); ++i) {
      EXPECT_EQ(opened->lanes[i].lane, lanes[i].lane);
      EXPECT_THAT(opened->lanes[i].refusal, IsEmpty());
      EXPECT_THAT(opened->lanes[i].frame, SizeIs(kFrameBytes));
      frames[lanes[i].lane] = opened->lanes[i].frame;
    }
    return absl::OkStatus();
  }

  std::map<int, std::string> frames;
  std::map<int, std::string> snapshots;
  std::map<int, double> rewards;
  std::vector<int> lost;  // in the last call
  int episodes = 0;
  int steps = 0;
};

std::shared_ptr<EnvDirectory> Listing(std::vector<wire::Endpoint> servers) {
  return std::make_shared<EnvDirectory>(std::move(servers));
}

EnvPool PoolOf(const std::vector<const EnvServer*>& servers) {
  std::vector<wire::Endpoint> endpoints;
  endpoints.reserve(servers.size());
  for (const EnvServer* server : servers) endpoints.push_back(server->Connect());
  return {Listing(endpoints), SampleHello(kLength), kFrameBytes};
}

// A pool of another run with a game on the server.
std::unique_ptr<EnvPool> OtherRunOn(const wire::Endpoint& server) {
  v1::SessionHello other_run = SampleHello(kLength);
  other_run.set_run_id("run-b");
  auto pool = std::make_unique<EnvPool>(Listing({server}), other_run, kFrameBytes);
  EXPECT_THAT(pool->Open(NewLanes({0})), IsOk());
  return pool;
}

TEST(EnvPool, GamesDoNotDependOnHowTheyAreSpread) {
  const EnvServer servers[3];
  EnvPool one = PoolOf({&servers[0]});
  EnvPool three = PoolOf({&servers[0], &servers[1], &servers[2]});
  Seen by_one;
  Seen by_three;
  const std::vector<int> lanes = {4, 0, 7, 2, 9};
  ASSERT_THAT(by_one.Open(&one, NewLanes(lanes)), IsOk());
  ASSERT_THAT(by_three.Open(&three, NewLanes(lanes)), IsOk());
  EXPECT_EQ(by_three.frames, by_one.frames);
  for (int i = 0; i < kLength + 5; ++i) {
    ASSERT_THAT(by_one.Step(&one, i % 2 == 0), IsOk());
    ASSERT_THAT(by_three.Step(&three, i % 2 == 0), IsOk());
    ASSERT_EQ(by_three.frames, by_one.frames) << i;
    ASSERT_EQ(by_three.snapshots, by_one.snapshots) << i;
  }
  EXPECT_EQ(by_one.episodes, 5);
  EXPECT_EQ(by_three.episodes, 5);
  EXPECT_EQ(by_three.rewards, by_one.rewards);
}

// The games continue elsewhere from their snapshots as if nothing had happened.
TEST(EnvPool, AFailedServerLosesNoGames) {
  const EnvServer spare;
  EnvPool undisturbed_pool = PoolOf({&spare});
  Seen undisturbed;
  ASSERT_THAT(undisturbed.Open(&undisturbed_pool, NewLanes({0, 1, 2, 3})), IsOk());

  const EnvServer servers[2];
  EnvPool pool = PoolOf({&servers[0], &servers[1]});
  Seen seen;
  ASSERT_THAT(seen.Open(&pool, NewLanes({0, 1, 2, 3})), IsOk());
  for (int i = 0; i < 10; ++i) ASSERT_THAT(seen.Step(&pool, true), IsOk());
  const Seen saved = seen;
  for (int i = 0; i < 3; ++i) ASSERT_THAT(seen.Step(&pool), IsOk());
  servers[1].server->Stop(absl::Milliseconds(50));
  ASSERT_THAT(seen.Step(&pool), IsOk());
  ASSERT_THAT(seen.lost, SizeIs(2));
  for (int i = 0; i < 14; ++i) ASSERT_THAT(undisturbed.Step(&undisturbed_pool), IsOk());
  ASSERT_THAT(seen.frames, SizeIs(2)) << "the others continue";
  for (const auto& [lane, frame] : seen.frames) EXPECT_EQ(frame, undisturbed.frames[lane]);

  Seen again;
  again.steps = saved.steps;
  std::vector<EnvClient::Lane> lanes;
  for (const int lane : seen.lost) lanes.push_back({lane, lane + 100, 1, saved.snapshots.at(lane)});
  ASSERT_THAT(again.Open(&pool, lanes), IsOk());
  EXPECT_THAT(again.lost, IsEmpty());
  while (again.steps < seen.steps) ASSERT_THAT(again.Step(&pool), IsOk());
  seen.frames.merge(again.frames);
  EXPECT_EQ(seen.frames, undisturbed.frames);
  for (int i = 0; i < kLength; ++i) {
    ASSERT_THAT(seen.Step(&pool), IsOk());
    ASSERT_THAT(undisturbed.Step(&undisturbed_pool), IsOk());
    ASSERT_EQ(seen.frames, undisturbed.frames) << i;
  }
}

TEST(EnvPool, LosingTheLastServerIsAnError) {
  const EnvServer server;
  EnvPool pool = PoolOf({&server});
  Seen seen;
  ASSERT_THAT(seen.Open(&pool, NewLanes({0, 1})), IsOk());
  server.server->Stop(absl::Milliseconds(50));
  // Not Cancelled, since Cancel was not called.
  EXPECT_THAT(seen.Step(&pool), StatusIs(absl::StatusCode::kUnavailable, HasSubstr(server.server->address())));
}

std::string LanesOn(const EnvServer& server) {
  v1::StatusReply status;
  server.service->FillStatus(&status);
  return status.peers_size() == 1 ? status.peers(0).state() : "no session";
}

TEST(EnvPool, PoolsOfOneDirectoryShareNoConnection) {
  const EnvServer server;
  const auto directory = Listing({server.Connect()});
  EnvPool one(directory, SampleHello(kLength), kFrameBytes);
  EnvPool two(directory, SampleHello(kLength), kFrameBytes);
  Seen seen;
  ASSERT_THAT(seen.Open(&one, NewLanes({0})), IsOk());
  ASSERT_THAT(seen.Open(&two, NewLanes({1})), IsOk());
  v1::StatusReply status;
  server.service->FillStatus(&status);
  ASSERT_EQ(status.peers_size(), 2);
  EXPECT_NE(status.peers(0).address(), status.peers(1).address());
}

TEST(EnvPool, GamesMoveWhenServersComeAndGo) {
  const EnvServer servers[3];
  const auto directory = EnvDirectory::Parse("envservers", "learner").value();
  EnvPool pool(directory, SampleHello(kLength), kFrameBytes);
  Seen seen;
  EXPECT_THAT(seen.Open(&pool, NewLanes({0})), StatusIs(absl::StatusCode::kUnavailable, testing::_));
  const std::vector<std::string> addresses = {servers[0].server->address(), servers[1].server->address(),
                                              servers[2].server->address()};
  directory->SetRegistered({addresses[0]});
  EXPECT_THAT(pool.Refresh(), IsEmpty());
  ASSERT_THAT(seen.Open(&pool, NewLanes({0, 1, 2, 3, 4, 5})), IsOk());
  EXPECT_EQ(LanesOn(servers[0]), "6 lanes");

  directory->SetRegistered(addresses);
  // Nothing waits for connections to be established, so games may move twice.
  EXPECT_TRUE(WaitUntil([&] {
    EXPECT_THAT(seen.Open(&pool, NewLanes(pool.Refresh())), IsOk());
    return std::all_of(std::begin(servers), std::end(servers),
                       [](const EnvServer& server) { return LanesOn(server) == "2 lanes"; });
  }));
  EXPECT_THAT(pool.Refresh(), IsEmpty()) << "the load is balanced";
  EXPECT_THAT(seen.Step(&pool), IsOk());

  directory->SetRegistered({addresses[1], addresses[2]});
  const std::vector<int> left = pool.Refresh();
  EXPECT_EQ(left.size(), 2u);
  ASSERT_THAT(seen.Open(&pool, NewLanes(left)), IsOk());
  EXPECT_TRUE(WaitUntil([&] { return LanesOn(servers[0]) == "no session"; }));
  EXPECT_EQ(LanesOn(servers[1]), "3 lanes");
  EXPECT_THAT(seen.Step(&pool), IsOk());
}

TEST(EnvPool, AServerLostDuringAMoveLosesAllItsGames) {
  const EnvServer servers[2];
  const auto directory = EnvDirectory::Parse("envservers", "learner").value();
  directory->SetRegistered({servers[0].server->address()});
  EnvPool pool(directory, SampleHello(kLength), kFrameBytes);
  Seen seen;
  ASSERT_THAT(seen.Open(&pool, NewLanes({0, 1, 2, 3})), IsOk());
  servers[0].server->Stop(absl::Milliseconds(50));
  directory->SetRegistered({servers[0].server->address(), servers[1].server->address()});
  std::vector<int> moved;
  ASSERT_TRUE(WaitUntil([&] {
    moved = pool.Refresh();
    return !moved.empty();
  }));
  EXPECT_THAT(moved, testing::UnorderedElementsAre(0, 1, 2, 3));
  ASSERT_THAT(seen.Open(&pool, NewLanes(moved)), IsOk());
  EXPECT_EQ(LanesOn(servers[1]), "4 lanes");
  EXPECT_THAT(seen.Step(&pool), IsOk());
}

TEST(EnvPool, AServerLostWhileLanesOpenLosesItsOtherLanesToo) {
  const EnvServer servers[2];
  EnvPool pool = PoolOf({&servers[0], &servers[1]});
  Seen seen;
  ASSERT_THAT(seen.Open(&pool, NewLanes({0, 1, 2, 3})), IsOk());
  // Lanes 1 and 3 are on the server with the higher address.
  const EnvServer& gone = servers[servers[0].server->address() < servers[1].server->address() ? 1 : 0];
  gone.server->Stop(absl::Milliseconds(50));
  ASSERT_THAT(seen.Open(&pool, NewLanes({1})), IsOk());
  EXPECT_THAT(seen.lost, ElementsAre(3));
  EXPECT_THAT(pool.Close({0}).value(), IsEmpty());
  ASSERT_THAT(seen.Open(&pool, NewLanes({0, 3})), IsOk());
  EXPECT_THAT(seen.lost, IsEmpty());
  EXPECT_THAT(seen.Step(&pool), IsOk());
  EXPECT_THAT(seen.frames, SizeIs(4));
}

TEST(EnvPool, NamesEveryServerWhenNoneCanBeReached) {
  std::vector<wire::Endpoint> endpoints;
  {
    const EnvServer gone[2];
    for (const EnvServer& server : gone) endpoints.push_back(server.Connect());
  }
  EnvPool pool(Listing(endpoints), SampleHello(kLength), kFrameBytes);
  for (int i = 0; i < 2; ++i) {  // the second attempt follows after a pause
    EXPECT_THAT(pool.Open(NewLanes({0})),
                StatusIs(absl::StatusCode::kUnavailable,
                         AllOf(HasSubstr(endpoints[0].address), HasSubstr(endpoints[1].address))));
  }
}

TEST(EnvPool, PlaysOnTheRemainingServers) {
  const EnvServer here;
  wire::Endpoint gone;
  {
    const EnvServer server;
    gone = server.Connect();
  }
  EnvPool pool(Listing({gone, here.Connect()}), SampleHello(kLength), kFrameBytes);
  Seen seen;
  ASSERT_THAT(seen.Open(&pool, NewLanes({0, 1})), IsOk());
  EXPECT_THAT(seen.Step(&pool), IsOk());
}

TEST(EnvPool, AnIncompatibleServerIsAnError) {
  const EnvServer server;
  v1::SessionHello hello = SampleHello(kLength);
  hello.set_texture_digest("0123456789abcdef");
  EnvPool pool(Listing({server.Connect()}), hello, kFrameBytes);
  EXPECT_THAT(pool.Open(NewLanes({0})), StatusIs(absl::StatusCode::kFailedPrecondition,
                                                 AllOf(HasSubstr(server.server->address()), HasSubstr("--textures"))));
}

// A server with another run or other textures is logged, and the others are used.
TEST(EnvPool, AnIncompatibleServerIsNoErrorIfAnotherIsCompatible) {
  const EnvServer fits;
  const EnvServer busy;
  const auto other = OtherRunOn(busy.Connect());
  EnvPool pool = PoolOf({&fits, &busy});
  Seen seen;
  testing::internal::CaptureStderr();
  ASSERT_THAT(seen.Open(&pool, NewLanes({0, 1})), IsOk());
  EXPECT_THAT(testing::internal::GetCapturedStderr(), AllOf(HasSubstr(busy.server->address()), HasSubstr("run-b")));
  EXPECT_EQ(LanesOn(fits), "2 lanes");
  EXPECT_THAT(seen.Step(&pool), IsOk());
}

// Before its first session with the pool, or after the server restarted and the other run was first to connect.
TEST(EnvPool, AServerThatAnotherRunOccupiesIsWaitedFor) {
  for (const bool is_known : {false, true}) {
    SCOPED_TRACE(is_known);
    const TempFolder folder;
    const std::string address = "unix:" + (folder / "server");
    const EnvServer before;
    const EnvServer after;
    auto server = *wire::Server::Create({address}, {before.service.get()});
    EnvPool pool(Listing({wire::Connect(address)}), SampleHello(kLength), kFrameBytes);
    Seen seen;
    if (is_known) {
      ASSERT_THAT(seen.Open(&pool, NewLanes({0})), IsOk());
    }
    server.reset();
    server = *wire::Server::Create({address}, {after.service.get()});
    auto other = OtherRunOn(wire::Connect(address));
    if (is_known) {
      EXPECT_THAT(seen.Step(&pool), testing::Not(IsOk()));
    }
    EXPECT_TRUE(WaitUntil([&] {
      const absl::Status status = pool.Open(NewLanes({0})).status();
      EXPECT_EQ(status.code(), absl::StatusCode::kUnavailable) << status;
      return absl::StrContains(status.message(), "serves run run-b");
    })) << "it is told whose server it is";
    other.reset();
    EXPECT_TRUE(WaitUntil([&] { return pool.Open(NewLanes({0})).ok(); }));
  }
}

TEST(EnvPool, AServerThatBelongsToAnotherRunIsAnError) {
  const EnvServer server;
  server.service->SetRun("run-b");
  EnvPool pool = PoolOf({&server});
  EXPECT_THAT(pool.Open(NewLanes({0})), StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("serves run run-b")));
}

// After a pause of the run, each server had to answer a probe first.
TEST(EnvPool, AServerThatEndsAnIdleSessionIsNotBlamed) {
  EnvServiceImpl::Options options;
  options.idle_timeout = absl::Milliseconds(500);
  EnvServer server = {*EnvServiceImpl::Create(*DefaultTextureDir(), options)};
  EnvPool pool(Listing({server.Connect()}), SampleHello(kLength), kFrameBytes);
  Seen seen;
  ASSERT_THAT(seen.Open(&pool, NewLanes({0, 1})), IsOk());
  ASSERT_TRUE(WaitUntil([&] { return LanesOn(server) == "no session"; }));
  EXPECT_THAT(seen.Step(&pool), StatusIs(absl::StatusCode::kUnavailable, HasSubstr("--idle_timeout")));
  EXPECT_EQ(pool.Report()[0].error, "") << "it answers";
  EXPECT_THAT(seen.Open(&pool, NewLanes({0, 1})), IsOk());
}

TEST(EnvPool, ClosesGames) {
  const EnvServer server;
  EnvPool pool = PoolOf({&server});
  Seen seen;
  ASSERT_THAT(seen.Open(&pool, NewLanes({0, 1, 2})), IsOk());
  const std::vector<int> two_and_one_that_is_not_open = {0, 2, 5};
  EXPECT_THAT(pool.Close(two_and_one_that_is_not_open).value(), IsEmpty());
  EXPECT_EQ(LanesOn(server), "1 lanes");
}

TEST(EnvPool, LeavesSomeFileDescriptorsFree) {
  const EnvServer server;
  EnvPool pool = PoolOf({&server});
  rlimit before = {};
  ASSERT_EQ(getrlimit(RLIMIT_NOFILE, &before), 0);
  const rlimit low = {before.rlim_cur - static_cast<rlim_t>(FilesLeft()) + 100, before.rlim_max};
  ASSERT_EQ(setrlimit(RLIMIT_NOFILE, &low), 0);
  Seen seen;
  EXPECT_THAT(seen.Open(&pool, NewLanes({0})), StatusIs(absl::StatusCode::kUnavailable, HasSubstr("ulimit -n")));
  ASSERT_EQ(setrlimit(RLIMIT_NOFILE, &before), 0);
  EXPECT_TRUE(WaitUntil([&] { return seen.Open(&pool, NewLanes({0})).ok(); }))
      << "retried once descriptors are available";
}

}  // namespace env_pool_test
}  // namespace craftfleet
