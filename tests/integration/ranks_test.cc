// Several learners of one run, as processes: which of them compute, die or resume does not change the result.

#include <csignal>
#include <memory>
#include <string>
#include <vector>

#include <absl/strings/str_cat.h>
#include <absl/strings/string_view.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/fakes/loopback.h"
#include "tests/integration/fleet_fixture.h"

namespace craftfleet {
namespace ranks_test {

using testing::HasSubstr;

// Ten short iterations.
constexpr char kFeedForwardConfig[] = R"(
  steps: 1280  lanes: 4  seed: 3  fragment_steps: 16  gradient_shards: 4
  network { frame_size: 36 }
  env { length: 90 }
  eval { every_steps: 500  episodes: 1  final_episodes: 1 }
  ppo { rollout_steps: 128  minibatch_size: 32  epochs: 1 }
  checkpoint { every_iterations: 2  keep: 20 }
)";

// The same of a recurrent agent, whose actors play during updates.
constexpr char kRecurrentConfig[] = R"(
  agent: "lstm_cnn"  steps: 1280  lanes: 4  seed: 3  fragment_steps: 16  gradient_shards: 4  overlap: 1
  network { frame_size: 36 }
  env { length: 90 }
  eval { every_steps: 0  final_episodes: 0 }
  ppo { rollout_steps: 128  minibatch_size: 32  epochs: 2 }
  checkpoint { every_iterations: 2  keep: 20 }
)";

// A lost rank ends the others within this time.
constexpr absl::Duration kUntilEnd = absl::Seconds(10);

class RanksTest : public FleetRunTest {
 protected:
  using Ranks = std::vector<std::unique_ptr<Process>>;

  void SetUp() override { TrainQuietly(kFeedForwardConfig); }

  // The learner's, also after a restart.
  static std::string Address() { return "unix:" + *shared_ / "learner"; }
  // Starts one of `world_size` learners, each with the same flags but its own rank. Rank 0 gets `more`.
  std::unique_ptr<Process> StartRank(const std::string& run, int rank, int world_size,
                                     const std::vector<std::string>& more = {}) const {
    std::vector<std::string> arguments = {
        "--config=" + *shared_ / "config.txt",
        "--logdir=" + Logdir(run),
        "--autoresume",
        "--threads=1",
        "--listen=" + Address(),
        absl::StrCat("--rank=", rank),
        absl::StrCat("--world_size=", world_size),
        absl::StrCat("--master_port=", port_),
    };
    arguments.insert(arguments.end(), more.begin(), more.end());
    return Start("craftfleet-learner", absl::StrCat(run, "-rank", rank), arguments);
  }
  // Starts all of them, rank 0 last.
  Ranks StartRanks(const std::string& run, int world_size) const {
    Ranks ranks(world_size);
    for (int rank = world_size - 1; rank >= 0; --rank) ranks[rank] = StartRank(run, rank, world_size);
    return ranks;
  }
  // An actor and an environment server, which outlive the learners.
  void StartWorkers(const std::string& run, const std::vector<std::string>& more = {}) {
    server_ = StartServer(run + "-server");
    actor_ = StartActor(run + "-actor", Address(), server_->WaitForAddress().value(), /*threads=*/2, more);
  }
  static void ExpectEnd(const Ranks& ranks, int exit_code, absl::Duration timeout, absl::string_view text) {
    for (const auto& rank : ranks) {
      EXPECT_EQ(rank->Wait(timeout), exit_code) << rank->Err();
      EXPECT_THAT(rank->Err(), HasSubstr(std::string(text)));
    }
  }
  static void ExpectComplete(const Ranks& ranks) { ExpectEnd(ranks, 0, kPatience, "the run is complete"); }

  const int port_ = FreePort();
  std::unique_ptr<Process> server_;
  std::unique_ptr<Process> actor_;
};

TEST_F(RanksTest, TwoLearnersEqualOneProcess) {
  StartWorkers("two");
  ExpectComplete(StartRanks("two", 2));
  ExpectLikeQuiet("two");
}

TEST_F(RanksTest, AKilledRankEndsTheOthersAndTheSameCommandsContinue) {
  StartWorkers("killed", {"--frames=scene"});
  Ranks ranks = StartRanks("killed", 2);
  WaitForCheckpoint("killed", 4);
  ranks[1]->Kill();
  EXPECT_EQ(ranks[0]->Wait(kUntilEnd), 1) << ranks[0]->Err();
  EXPECT_THAT(ranks[0]->Err(), HasSubstr("craftfleet-learner: rank 1 is lost: "));
  ASSERT_FALSE(PathExists(Logdir("killed") + "/" + kLastCheckpoint));
  ExpectComplete(StartRanks("killed", 2));
  ExpectLikeQuiet("killed");
}

TEST_F(RanksTest, AKilledRank0EndsTheOthersAndMoreLearnersContinue) {
  StartWorkers("first-killed");
  Ranks ranks = StartRanks("first-killed", 2);
  WaitForCheckpoint("first-killed", 4);
  ranks[0]->Kill();
  EXPECT_EQ(ranks[1]->Wait(kUntilEnd), 1) << ranks[1]->Err();
  EXPECT_THAT(ranks[1]->Err(), HasSubstr("craftfleet-learner: rank 0 is lost: "));
  ASSERT_FALSE(PathExists(Logdir("first-killed") + "/" + kLastCheckpoint));
  ExpectComplete(StartRanks("first-killed", 3));
  ExpectLikeQuiet("first-killed");
}

TEST_F(RanksTest, StoppingRank0StopsAllAndOneLearnerContinues) {
  StartWorkers("stopped");
  Ranks ranks = StartRanks("stopped", 3);
  WaitForCheckpoint("stopped", 2);
  ranks[0]->Signal(SIGTERM);
  EXPECT_EQ(ranks[0]->Wait(kUntilEnd), 0) << ranks[0]->Err();
  ranks.erase(ranks.begin());
  ExpectEnd(ranks, 0, kUntilEnd, "rank 0 has stopped");
  ASSERT_FALSE(PathExists(Logdir("stopped") + "/" + kLastCheckpoint));
  ExpectComplete(StartRanks("stopped", 1));
  ExpectLikeQuiet("stopped");
}

TEST_F(RanksTest, ARankThatDoesNotComeIsNamedAfterTheTimeout) {
  Ranks ranks;
  for (const int rank : {0, 1}) ranks.push_back(StartRank("missing", rank, 3, {"--rank_timeout=5s"}));
  ExpectEnd(ranks, 1, kPatience, absl::StrCat("rank 2 of 3 has not come to 127.0.0.1:", port_, " within 5s"));
  EXPECT_FALSE(PathExists(Logdir("missing") + "/config.txt")) << "the run has not begun";
}

TEST_F(RanksTest, ARankWithAnotherConfigurationIsRefusedByName) {
  Ranks ranks;
  ranks.push_back(StartRank("other", 0, 2));
  ranks.push_back(StartRank("other", 1, 2, {"--seed=4"}));
  ExpectEnd(ranks, 1, kPatience,
            "rank 1: its flags ask for another configuration than rank 0's: modified: seed: 3 -> 4");
}

class RecurrentRanksTest : public RanksTest {
 protected:
  void SetUp() override { TrainQuietly(kRecurrentConfig); }
};

TEST_F(RecurrentRanksTest, TwoLearnersEqualOneProcessAlsoWhenTheyResume) {
  StartWorkers("recurrent");
  Ranks ranks = StartRanks("recurrent", 2);
  WaitForCheckpoint("recurrent", 4);
  for (const auto& rank : ranks) rank->Kill();
  ASSERT_FALSE(PathExists(Logdir("recurrent") + "/" + kLastCheckpoint));
  ExpectComplete(StartRanks("recurrent", 2));
  ExpectLikeQuiet("recurrent");
}

}  // namespace ranks_test
}  // namespace craftfleet
