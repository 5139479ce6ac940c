// Runs that resume from checkpoints that an undisturbed run of this size does not write, and with a lane whose snapshot
// is no game.

#include <csignal>
#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_split.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "common/io/snapshot_envelope.h"
#include "learner/run/checkpoint.h"
#include "tests/fakes/wait_until.h"
#include "tests/integration/ask_status.h"
#include "tests/integration/small_run.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;
using testing::SizeIs;

constexpr int kLanes = 4;
constexpr int kLength = 20;  // of an episode
constexpr int kSpoiled = 2;  // the lane with the invalid snapshot

class OddCheckpointsTest : public SmallRunTest {
 protected:
  // Changes the state in a checkpoint.
  static void Edit(const std::string& folder, const std::function<void(v1::CheckpointState*)>& change) {
    auto checkpoint = LoadCheckpoint(folder, "");
    ASSERT_THAT(checkpoint, IsOk());
    change(&checkpoint->state);
    std::filesystem::remove_all(folder);
    ASSERT_THAT(WriteCheckpointFiles(folder, *checkpoint), IsOk());
  }
  std::vector<std::string> Lines(const std::string& run, const std::string& file) const {
    return absl::StrSplit(Text(run, file), '\n', absl::SkipEmpty());
  }
};

// The envelope of the snapshot is valid, so the learner accepts it, but no environment server can restore it.
TEST_F(OddCheckpointsTest, ALaneWithAnInvalidSnapshotIsResetAndTheOthersAreUnaffected) {
  CopyTrained("quiet");
  CopyTrained("run");
  Edit(Checkpoint("run", 2), [&](v1::CheckpointState* state) {
    v1::LaneState* lane = state->mutable_lanes(kSpoiled);
    ASSERT_FALSE(lane->previous_snapshot().empty());
    lane->set_snapshot(SealSnapshot(EnvDigest("crafter", kLength), "no game"));
  });

  const auto learner =
      Start("craftfleet-learner",
            Flags("run", {"--listen=127.0.0.1:0", "--resume", "--steps=64000", "--resume_from=iter-00000002"}));
  const std::string address = learner->WaitForAddress("listening on ", kPatience).value();
  const auto server = Start("craftfleet-envserver", {"--listen=127.0.0.1:0", "--learner=" + address});
  const auto actor = Start("craftfleet-actor", {"--learner=" + address, "--envservers=learner"});
  ASSERT_TRUE(WaitUntil([this] { return PathExists(Checkpoint("run", 4)); }, kPatience))
      << learner->Err() << actor->Err();
  EXPECT_EQ(MetricOf(address, "lanes_reset"), 1);
  // Iteration 3 is played with the weights of checkpoint 2, which are the same.
  const auto quiet = LoadCheckpointState(Checkpoint("quiet", 3));
  const auto reset = LoadCheckpointState(Checkpoint("run", 3));
  ASSERT_THAT(quiet, IsOk());
  ASSERT_THAT(reset, IsOk());
  for (int lane = 0; lane < kLanes; ++lane) {
    EXPECT_EQ(reset->lanes(lane).next_fragment(), quiet->lanes(lane).next_fragment()) << lane;
    const bool is_same = reset->lanes(lane).snapshot() == quiet->lanes(lane).snapshot();
    EXPECT_EQ(is_same, lane != kSpoiled) << lane;
  }
  EXPECT_EQ(actor->Wait(absl::ZeroDuration()), std::nullopt) << actor->Err();
  EXPECT_THAT(learner->Err(), HasSubstr(absl::StrCat("lane ", kSpoiled)));
  learner->Signal(SIGTERM);
  EXPECT_EQ(learner->Wait(kPatience), 0) << learner->Err();
}

// Actors would end at such weights one by one, and the learner wait for others for ever.
TEST_F(OddCheckpointsTest, WeightsThatAreNotFiniteAreRefusedWithTheirCheckpoint) {
  CopyTrained("run");
  auto checkpoint = LoadCheckpoint(Checkpoint("run", 3), "");
  ASSERT_THAT(checkpoint, IsOk());
  std::string weights = *checkpoint->weights;
  weights.replace(weights.size() - 4, 4, std::string("\0\0\xc0\x7f", 4));  // NaN
  checkpoint->weights = std::make_shared<const std::string>(std::move(weights));
  std::filesystem::remove_all(Checkpoint("run", 3));
  ASSERT_THAT(WriteCheckpointFiles(Checkpoint("run", 3), *checkpoint), IsOk());
  const Ended ended = Run("craftfleet-learner", Flags("run", {"--listen=127.0.0.1:0", "--resume", "--steps=640"}));
  EXPECT_EQ(ended.exit_code, 1) << ended.err;
  EXPECT_THAT(ended.err, HasSubstr("checkpoint iter-00000003 of " + Logdir("run")));
  EXPECT_THAT(ended.err, HasSubstr("is nan, want finite numbers"));
}

TEST_F(OddCheckpointsTest, ALaneStateOfAnotherSizeIsRefused) {
  CopyTrained("run");
  Edit(Checkpoint("run", 3), [](v1::CheckpointState* state) { state->mutable_lanes(1)->add_state(0.5); });
  const Ended ended = Run("craftfleet-learner", Flags("run", {"--listen=127.0.0.1:0", "--resume", "--steps=640"}));
  EXPECT_EQ(ended.exit_code, 1) << ended.err;
  EXPECT_THAT(ended.err, HasSubstr("the checkpoint's lane 1 has a recurrent state of 1 numbers, want 0"));
}

// A made-up fragment is accepted, since it looks like others. The next one cannot be played from its snapshot, so the
// lane is reset to the beginning of the iteration, and nothing of the first remains.
TEST_F(OddCheckpointsTest, AMadeUpFragmentIsPlayedAgainByOthers) {
  ASSERT_THAT(WriteFileSynced(config(), R"(
    steps: 128  lanes: 4  seed: 3  fragment_steps: 8
    env { length: 20 }
    ppo { rollout_steps: 64  minibatch_size: 32  epochs: 1 }
    checkpoint { every_iterations: 1  keep: 20 }
    eval { every_steps: 0  final_episodes: 0 }
  )"),
              IsOk());
  Train("quiet");
  const auto learner = Start("craftfleet-learner", Flags("run", {"--listen=127.0.0.1:0"}));
  const std::string address = learner->WaitForAddress("listening on ", kPatience).value();
  const Ended liar = Run("bad_peer", {"--role=actor", "--misdeed=pretending", "--learner=" + address});
  ASSERT_EQ(liar.exit_code, 0) << liar.err;
  const auto server = Start("craftfleet-envserver", {"--listen=127.0.0.1:0", "--learner=" + address});
  const auto actor = Start("craftfleet-actor", {"--learner=" + address, "--envservers=learner"});
  ASSERT_TRUE(WaitUntil([&] { return MetricOf(address, "lanes_reset") == 1; }, kPatience)) << learner->Err();
  EXPECT_EQ(learner->Wait(kPatience), 0) << learner->Err();
  EXPECT_EQ(actor->Wait(kPatience), 0) << actor->Err();
  EXPECT_EQ(Lines("run", "stats.jsonl"), Lines("quiet", "stats.jsonl"));
  for (const char* file : {"weights.safetensors", "optimizer.safetensors"}) {
    EXPECT_EQ(ReadFile(JoinPath(Checkpoint("run", 2), file)).value_or("none"),
              ReadFile(JoinPath(Checkpoint("quiet", 2), file)).value_or("no file"))
        << file;
  }
}

// Training used to wait forever for evaluations beyond episode 10,000.
TEST_F(OddCheckpointsTest, EvaluationsBeyondEpisodeTenThousandEnd) {
  constexpr int kEpisodes = 3;  // of each of two parts
  ASSERT_THAT(WriteFileSynced(config(), R"(
    steps: 128  lanes: 4  seed: 3  fragment_steps: 16
    env { length: 1 }
    ppo { rollout_steps: 64  minibatch_size: 32  epochs: 1 }
    checkpoint { every_iterations: 1  keep: 20 }
    eval { every_steps: 0  final_episodes: 3 }
  )"),
              IsOk());
  Train("run");
  // The first part plays episodes 9,998 to 10,000, the second 10,001 to 10,003.
  Edit(Checkpoint("run", 1), [](v1::CheckpointState* state) { state->set_next_eval_episode(9998); });
  const Ended ended = Run("craftfleet train", Flags("run", {"--resume", "--resume_from=iter-00000001"}));
  ASSERT_EQ(ended.exit_code, 0) << ended.err;
  for (const char* mode : {"argmax", "sampled"}) {
    const std::vector<std::string> lines = Lines("run", absl::StrCat("final_", mode, ".jsonl"));
    ASSERT_THAT(lines, SizeIs(kEpisodes)) << mode;
    EXPECT_EQ(nlohmann::json::parse(lines.back())["length"], 1);
  }
  const auto state = LoadCheckpointState(Checkpoint("run", 2));
  ASSERT_THAT(state, IsOk());
  EXPECT_EQ(state->next_eval_episode(), 9998) << "final evaluations do not count";
}

}  // namespace
}  // namespace craftfleet
