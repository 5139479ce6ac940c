#include "deploy/cli/inspect/run_state.h"

#include <memory>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/io/files.h"
#include "learner/run/checkpoint_store.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/temp_folder.h"
#include "tests/learner/run/run_samples.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;

class RunStateTest : public testing::Test {
 protected:
  // The state of a run of 4,000 steps whose newest checkpoint this is.
  RunState StateWith(Checkpoint* checkpoint) {
    EXPECT_THAT(CheckpointStore::Open(folder_ / "checkpoints")->Write(*checkpoint), IsOk());
    checkpoint->state.set_iteration(checkpoint->state.iteration() + 1);
    const auto state = ReadRunState(folder_.path(), 4000);
    EXPECT_THAT(state, IsOk());
    return state.value_or(RunState());
  }

  const TempFolder folder_;
};

TEST_F(RunStateTest, ARunWithoutCheckpointsHasNotBegun) {
  const auto state = ReadRunState(folder_ / "nowhere", 4000);
  ASSERT_THAT(state, IsOk());
  EXPECT_FALSE(state->begun);
  EXPECT_FALSE(state->finished);
}

TEST_F(RunStateTest, TheNewestCheckpointCountsItsSteps) {
  Checkpoint checkpoint = SampleCheckpoint(3);
  checkpoint.state.set_env_steps(3000);
  const RunState state = StateWith(&checkpoint);
  EXPECT_TRUE(state.begun);
  EXPECT_EQ(state.steps, 3000);
  EXPECT_FALSE(state.finished);
}

// The checkpoint at the end of training, of a learner that was stopped before it had all evaluations.
TEST_F(RunStateTest, IsNotFinishedWhileAnEvaluationIsPending) {
  Checkpoint checkpoint = SampleCheckpoint(4);
  checkpoint.state.mutable_config()->mutable_eval()->set_final_episodes(4);
  checkpoint.state.set_env_steps(4000);
  EXPECT_FALSE(StateWith(&checkpoint).finished) << "the final evaluation has not begun";

  checkpoint.state.set_final_evaluation_steps(4000);
  v1::PendingEvaluation* pending = checkpoint.state.add_pending();
  pending->set_number(1);
  pending->set_env_steps(4000);
  pending->set_first_episode(1);
  pending->set_episodes(4);
  pending->set_final(true);
  checkpoint.evaluation_weights = {std::make_shared<const std::string>("weights")};
  EXPECT_FALSE(StateWith(&checkpoint).finished) << "the final evaluation is pending";

  pending->set_final(false);
  EXPECT_FALSE(StateWith(&checkpoint).finished) << "an evaluation of training is pending";

  checkpoint.state.clear_pending();
  checkpoint.evaluation_weights.clear();
  EXPECT_TRUE(StateWith(&checkpoint).finished);
  EXPECT_FALSE(ReadRunState(folder_.path(), 4001)->finished) << "more steps are wanted now";
}

TEST_F(RunStateTest, NeedsNoFinalEvaluationIfNoneIsWanted) {
  Checkpoint checkpoint = SampleCheckpoint(4);
  checkpoint.state.mutable_config()->mutable_eval()->set_final_episodes(0);
  checkpoint.state.set_env_steps(4000);
  EXPECT_TRUE(StateWith(&checkpoint).finished);
}

TEST_F(RunStateTest, ADamagedCheckpointIsNamed) {
  ASSERT_THAT(CheckpointStore::Open(folder_ / "checkpoints")->Write(SampleCheckpoint(3)), IsOk());
  ASSERT_THAT(WriteFileSynced(folder_ / "checkpoints/iter-00000003/state.pb", "garbage"), IsOk());
  EXPECT_THAT(std::string(ReadRunState(folder_.path(), 1).status().message()),
              HasSubstr(folder_ / "checkpoints/iter-00000003"));
}

}  // namespace
}  // namespace craftfleet
