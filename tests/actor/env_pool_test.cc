#include "actor/env_pool.h"

#include <sys/resource.h>

#include <algorithm>
#include <iterator>
#include <map>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <absl/time/clock.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/process_usage.h"
#include "tests/fakes/env_server.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/wait_until.h"

namespace craftfleet {
namespace {

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

// What the games of some lanes look like, whoever runs them.
struct Seen {
  // Steps every lane once, with actions that depend on lane and step alone.
  absl::Status Step(EnvPool* pool, bool snapshot = false) {
    std::vector<int> lanes;
    for (const auto& [lane, frame] : frames) lanes.push_back(lane);
    lanes = pool->Arrange(lanes);
    std::vector<Action> actions;
    actions.reserve(lanes.size());
    for (const int lane : lanes) actions.push_back(static_cast<Action>((lane * 3 + steps * 5) % kNumActions));
    StepBatch batch;
    if (absl::Status status = pool->Step(lanes, actions, snapshot, &batch, &lost); !status.ok()) return status;
    ++steps;
    for (const int lane : lost) {
      lanes.erase(std::remove(lanes.begin(), lanes.end(), lane), lanes.end());
      frames.erase(lane);
    }
    EXPECT_EQ(batch.rewards.size(), lanes.size());
    for (size_t row = 0; row < lanes.size(); ++row) {
      frames[lanes[row]] = batch.frames.substr(row * kFrameBytes, kFrameBytes);
      rewards[lanes[row]] += batch.rewards[row];
      if (snapshot) snapshots[lanes[row]] = batch.snapshots[row];
    }
    episodes += static_cast<int>(batch.episodes.size());
    EXPECT_EQ(batch.last_frames.size(), batch.episodes.size() * kFrameBytes);
    return absl::OkStatus();
  }
  absl::Status Open(EnvPool* pool, const std::vector<EnvClient::Lane>& lanes) {
    std::string opened;
    std::vector<EnvClient::Refused> refused;
    if (absl::Status status = pool->Open(lanes, &opened, &lost, &refused); !status.ok()) return status;
    EXPECT_THAT(refused, IsEmpty());
    for (size_t i = 0; i < lanes.size(); ++i) frames[lanes[i].lane] = opened.substr(i * kFrameBytes, kFrameBytes);
    return absl::OkStatus();
  }

  std::map<int, std::string> frames;
  std::map<int, std::string> snapshots;
  std::map<int, double> rewards;
  std::vector<int> lost;  // by the last call
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

TEST(EnvPool, SpreadsGamesEvenly) {
  const EnvServer servers[2];
  EnvPool pool = PoolOf({&servers[0], &servers[1]});
  Seen seen;
  ASSERT_THAT(seen.Open(&pool, NewLanes({0, 1, 2, 3})), IsOk());
  EXPECT_THAT(pool.Arrange({3, 2, 1, 0}), ElementsAre(2, 0, 3, 1));
  ASSERT_THAT(seen.Open(&pool, NewLanes({2})), IsOk()) << "again";
  for (const EnvServer& server : servers) {
    v1::StatusReply status;
    server.service->FillStatus(&status);
    ASSERT_EQ(status.peers_size(), 1);
    EXPECT_EQ(status.peers(0).state(), "2 lanes");
  }
}

// The games go on elsewhere from their snapshots as if nothing had been.
TEST(EnvPool, AServerThatGoesTakesNothingWithIt) {
  const EnvServer spare;
  EnvPool untroubled_pool = PoolOf({&spare});
  Seen untroubled;
  ASSERT_THAT(untroubled.Open(&untroubled_pool, NewLanes({0, 1, 2, 3})), IsOk());

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
  for (int i = 0; i < 14; ++i) ASSERT_THAT(untroubled.Step(&untroubled_pool), IsOk());
  ASSERT_THAT(seen.frames, SizeIs(2)) << "the others go on";
  for (const auto& [lane, frame] : seen.frames) EXPECT_EQ(frame, untroubled.frames[lane]);

  Seen again;
  again.steps = saved.steps;
  std::vector<EnvClient::Lane> lanes;
  for (const int lane : seen.lost) lanes.push_back({lane, lane + 100, 1, saved.snapshots.at(lane)});
  ASSERT_THAT(again.Open(&pool, lanes), IsOk());
  EXPECT_THAT(again.lost, IsEmpty());
  while (again.steps < seen.steps) ASSERT_THAT(again.Step(&pool), IsOk());
  seen.frames.merge(again.frames);
  EXPECT_EQ(seen.frames, untroubled.frames);
  for (int i = 0; i < kLength; ++i) {
    ASSERT_THAT(seen.Step(&pool), IsOk());
    ASSERT_THAT(untroubled.Step(&untroubled_pool), IsOk());
    ASSERT_EQ(seen.frames, untroubled.frames) << i;
  }
}

TEST(EnvPool, TheLastServerThatGoesIsAnError) {
  const EnvServer server;
  EnvPool pool = PoolOf({&server});
  Seen seen;
  ASSERT_THAT(seen.Open(&pool, NewLanes({0, 1})), IsOk());
  server.server->Stop(absl::Milliseconds(50));
  // Not Cancelled: nobody here asked for it.
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
  EXPECT_THAT(seen.Open(&pool, NewLanes({0})),
              StatusIs(absl::StatusCode::kUnavailable, HasSubstr("no environment server is known")));
  const std::vector<std::string> addresses = {servers[0].server->address(), servers[1].server->address(),
                                              servers[2].server->address()};
  directory->SetRegistered({addresses[0]});
  EXPECT_THAT(pool.Refresh(), IsEmpty());
  ASSERT_THAT(seen.Open(&pool, NewLanes({0, 1, 2, 3, 4, 5})), IsOk());
  EXPECT_EQ(LanesOn(servers[0]), "6 lanes");

  directory->SetRegistered(addresses);
  // Connecting takes its time, which nobody waits for: games may move twice.
  EXPECT_TRUE(WaitUntil([&] {
    EXPECT_THAT(seen.Open(&pool, NewLanes(pool.Refresh())), IsOk());
    return std::all_of(std::begin(servers), std::end(servers),
                       [](const EnvServer& server) { return LanesOn(server) == "2 lanes"; });
  }));
  EXPECT_THAT(pool.Refresh(), IsEmpty()) << "even as it is";
  EXPECT_THAT(seen.Step(&pool), IsOk());

  directory->SetRegistered({addresses[1], addresses[2]});
  const std::vector<int> left = pool.Refresh();
  EXPECT_EQ(left.size(), 2u);
  ASSERT_THAT(seen.Open(&pool, NewLanes(left)), IsOk());
  EXPECT_TRUE(WaitUntil([&] { return LanesOn(servers[0]) == "no session"; }));
  EXPECT_EQ(LanesOn(servers[1]), "3 lanes");
  EXPECT_THAT(seen.Step(&pool), IsOk());
}

TEST(EnvPool, AServerThatIsGoneWhenGamesAreToMoveLosesAllOfThem) {
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

TEST(EnvPool, AServerThatGoesWhileLanesOpenTakesOthersWithIt) {
  const EnvServer servers[2];
  EnvPool pool = PoolOf({&servers[0], &servers[1]});
  Seen seen;
  ASSERT_THAT(seen.Open(&pool, NewLanes({0, 1, 2, 3})), IsOk());
  // Lanes 1 and 3 are on the second one by address.
  const EnvServer& gone = servers[servers[0].server->address() < servers[1].server->address() ? 1 : 0];
  gone.server->Stop(absl::Milliseconds(50));
  ASSERT_THAT(seen.Open(&pool, NewLanes({1})), IsOk());
  EXPECT_THAT(seen.lost, ElementsAre(3));
  std::vector<int> lost;
  EXPECT_THAT(pool.Close({0}, &lost), IsOk());
  EXPECT_THAT(lost, IsEmpty());
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
  std::string frames;
  std::vector<int> lost;
  std::vector<EnvClient::Refused> refused;
  for (int i = 0; i < 2; ++i) {  // the second time it waits before it tries again
    EXPECT_THAT(pool.Open(NewLanes({0}), &frames, &lost, &refused),
                StatusIs(absl::StatusCode::kUnavailable,
                         AllOf(HasSubstr(endpoints[0].address), HasSubstr(endpoints[1].address))));
  }
}

TEST(EnvPool, PlaysWithTheServersThatAreLeft) {
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

TEST(EnvPool, AServerThatDoesNotFitIsAnErrorToAct) {
  const EnvServer server;
  v1::SessionHello hello = SampleHello(kLength);
  hello.set_texture_digest("0123456789abcdef");
  EnvPool pool(Listing({server.Connect()}), hello, kFrameBytes);
  std::string frames;
  std::vector<int> lost;
  std::vector<EnvClient::Refused> refused;
  EXPECT_THAT(pool.Open(NewLanes({0}), &frames, &lost, &refused),
              StatusIs(absl::StatusCode::kFailedPrecondition,
                       AllOf(HasSubstr(server.server->address()), HasSubstr("--textures"))));
}

// One of them may be of another run, or have other textures: it is said, and the others are played on.
TEST(EnvPool, AServerThatDoesNotFitIsNoTroubleWhereAnotherDoes) {
  const EnvServer fits;
  const EnvServer busy;
  v1::SessionHello other_run = SampleHello(kLength);
  other_run.set_run_id("run-b");
  EnvPool other_pool(Listing({busy.Connect()}), other_run, kFrameBytes);
  Seen other;
  ASSERT_THAT(other.Open(&other_pool, NewLanes({0})), IsOk());

  EnvPool pool = PoolOf({&fits, &busy});
  Seen seen;
  testing::internal::CaptureStderr();
  ASSERT_THAT(seen.Open(&pool, NewLanes({0, 1})), IsOk());
  EXPECT_THAT(testing::internal::GetCapturedStderr(),
              AllOf(HasSubstr(busy.server->address()), HasSubstr("serves run run-b")));
  EXPECT_EQ(LanesOn(fits), "2 lanes");
  EXPECT_THAT(seen.Step(&pool), IsOk());
}

TEST(EnvPool, ClosesGames) {
  const EnvServer server;
  EnvPool pool = PoolOf({&server});
  Seen seen;
  ASSERT_THAT(seen.Open(&pool, NewLanes({0, 1, 2})), IsOk());
  const std::vector<int> two_and_one_that_is_not_open = {0, 2, 5};
  std::vector<int> lost;
  ASSERT_THAT(pool.Close(two_and_one_that_is_not_open, &lost), IsOk());
  EXPECT_EQ(LanesOn(server), "1 lanes");
}

TEST(EnvPool, LeavesTheLastFilesToOthers) {
  const EnvServer server;
  EnvPool pool = PoolOf({&server});
  rlimit before = {};
  ASSERT_EQ(getrlimit(RLIMIT_NOFILE, &before), 0);
  const rlimit low = {before.rlim_cur - static_cast<rlim_t>(FilesLeft()) + 100, before.rlim_max};
  ASSERT_EQ(setrlimit(RLIMIT_NOFILE, &low), 0);
  Seen seen;
  EXPECT_THAT(seen.Open(&pool, NewLanes({0})), StatusIs(absl::StatusCode::kUnavailable, HasSubstr("ulimit -n")));
  ASSERT_EQ(setrlimit(RLIMIT_NOFILE, &before), 0);
  EXPECT_TRUE(WaitUntil([&] { return seen.Open(&pool, NewLanes({0})).ok(); })) << "tried again, and found room";
}

}  // namespace
}  // namespace craftfleet
