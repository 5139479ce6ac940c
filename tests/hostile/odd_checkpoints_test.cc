// Runs that resume from checkpoints that an undisturbed run of this size does not write, and with a lane whose snapshot
// is no game.

#include <csignal>
#include <filesystem>
#include <functional>
#include <memory>
#include <string>

#include <absl/strings/str_cat.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/io/snapshot_envelope.h"
#include "learner/run/checkpoint.h"
#include "tests/fakes/wait_until.h"
#include "tests/integration/ask_status.h"
#include "tests/integration/small_run.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;

constexpr int kLanes = 4;
constexpr int kLength = 20;  // of an episode
constexpr int kSpoiled = 2;  // the lane with the invalid snapshot

class OddCheckpointsTest : public SmallRunTest {
 protected:
  // Changes the state in a checkpoint.
  static void Edit(const std::string& folder, const std::function<void(v1::CheckpointState*)>& change) {
    auto checkpoint = LoadCheckpoint(folder);
    ASSERT_THAT(checkpoint, IsOk());
    change(&checkpoint->state);
    std::filesystem::remove_all(folder);
    ASSERT_THAT(WriteCheckpointFiles(folder, *checkpoint), IsOk());
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
  auto checkpoint = LoadCheckpoint(Checkpoint("run", 3));
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

}  // namespace
}  // namespace craftfleet
