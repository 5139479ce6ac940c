#include "deploy/cli/eval/eval_plan.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/config/config.h"
#include "tests/fakes/status_matchers.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;

v1::CheckpointState StateWith(int final_episodes, int64_t next_episode) {
  v1::CheckpointState state;
  *state.mutable_config() = DefaultRunConfig();
  state.mutable_config()->mutable_env()->set_frame_size(64);
  state.mutable_config()->mutable_eval()->set_env("crafter:inventory=off");
  state.mutable_config()->mutable_eval()->set_seed(7);
  state.mutable_config()->mutable_eval()->set_final_episodes(final_episodes);
  state.set_next_eval_episode(next_episode);
  return state;
}

TEST(FinalEvaluation, ComesAfterTheEpisodesPlayedDuringTraining) {
  const auto plan = FinalEvaluation(StateWith(20, 201));
  ASSERT_THAT(plan, IsOk());
  EXPECT_EQ(plan->env.name(), "crafter:inventory=off");
  EXPECT_EQ(plan->env.frame_size(), 64);
  ASSERT_EQ(plan->parts.size(), 2);
  EXPECT_EQ(plan->parts[0].name, "argmax");
  EXPECT_TRUE(plan->parts[0].options.greedy);
  EXPECT_EQ(plan->parts[0].options.first_episode, 201);
  EXPECT_EQ(plan->parts[1].name, "sampled");
  EXPECT_FALSE(plan->parts[1].options.greedy);
  EXPECT_EQ(plan->parts[1].options.first_episode, 221);
  for (const EvalPart& part : plan->parts) {
    EXPECT_EQ(part.options.episodes, 20);
    EXPECT_EQ(part.options.seed, 7);
  }
}

TEST(FinalEvaluation, OfARunWithoutOthersBeginsWithTheFirstEpisode) {
  EXPECT_EQ(FinalEvaluation(StateWith(3, 0))->parts[0].options.first_episode, 1);
}

TEST(FinalEvaluation, IsRefusedForARunWithoutOne) {
  EXPECT_THAT(FinalEvaluation(StateWith(0, 11)),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("eval.final_episodes is 0")));
}

}  // namespace
}  // namespace craftfleet
