#include "learner/ppo/rollout.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace craftfleet {
namespace rollout_test {

constexpr int kFrameBytes = 12;
constexpr int kStateSize = 2;

RolloutOptions Options(const GaeOptions& gae = {}) {
  RolloutOptions options;
  options.frame_bytes = kFrameBytes;
  options.state_size = kStateSize;
  options.gae = gae;
  return options;
}

Fragment TwoSteps() {
  Fragment fragment;
  fragment.lane = 3;
  fragment.number = 9;
  fragment.frames = std::string(kFrameBytes, 'a') + std::string(kFrameBytes, 'b');
  fragment.actions = {5, 16};
  fragment.log_probs = {-1, -2};
  fragment.values = {10, 20};
  fragment.rewards = {1, 2};
  fragment.ends = {StepEnd::kNone, StepEnd::kTerminated};
  fragment.bootstrap_value = 7;
  fragment.states = {0.5F, -0.5F};
  return fragment;
}

TEST(Rollout, AppendsTheFragmentsStepsWithTheirAdvantages) {
  const Fragment first = TwoSteps();
  const Fragment second = TwoSteps();
  Rollout rollout;
  const RolloutOptions options = Options({0.5, 0.5, false});
  AppendFragment(first, options, &rollout);
  AppendFragment(second, options, &rollout);
  ASSERT_EQ(rollout.size(), 4);
  EXPECT_EQ(rollout.frames[1], reinterpret_cast<const uint8_t*>(first.frames.data()) + kFrameBytes);
  EXPECT_EQ(rollout.frames[2], reinterpret_cast<const uint8_t*>(second.frames.data()));
  EXPECT_EQ(rollout.actions[3], Action::kMakeIronSword);
  EXPECT_EQ(rollout.log_probs, (std::vector<float>{-1, -2, -1, -2}));
  EXPECT_EQ(rollout.values, (std::vector<float>{10, 20, 10, 20}));
  EXPECT_EQ(rollout.advantages, (std::vector<float>{1 + 10 - 10 - 4.5, -18, 1 + 10 - 10 - 4.5, -18}));
  EXPECT_EQ(rollout.returns, (std::vector<float>{6.5, 2, 6.5, 2}));
}

// An agent whose value head says (value - 2) / 4.
TEST(Rollout, ValuesAreDenormalisedBeforeAdvantages) {
  RolloutOptions options = Options({0.5, 0.5, false});
  Fragment plain = TwoSteps();
  plain.ends = {StepEnd::kTruncated, StepEnd::kNone};
  plain.truncation_values = {6};
  Fragment scaled = plain;
  scaled.values = {2, 4.5F};
  scaled.truncation_values = {1};
  scaled.bootstrap_value = 1.25F;
  Rollout wanted;
  AppendFragment(plain, options, &wanted);
  options.value_scale = {2, 4};
  Rollout rollout;
  AppendFragment(scaled, options, &rollout);
  EXPECT_EQ(rollout.values, wanted.values);
  EXPECT_EQ(rollout.advantages, wanted.advantages);
  EXPECT_EQ(rollout.returns, wanted.returns);
}

TEST(Rollout, RowsKnowWhereTheyStartAndFromWhichState) {
  std::vector<Fragment> fragments(5, TwoSteps());
  fragments[0].ends = {StepEnd::kNone, StepEnd::kNone};
  fragments[1].ends = {StepEnd::kTruncated, StepEnd::kTerminated};
  fragments[1].truncation_values = {0};
  fragments[3].lane = 4;
  fragments[3].ends = {StepEnd::kNone, StepEnd::kNone};
  fragments[4].lane = 4;
  Rollout rollout;
  for (const Fragment& fragment : fragments) AppendFragment(fragment, Options(), &rollout);
  using S = RowStart;
  EXPECT_EQ(rollout.starts, (std::vector<S>{S::kLane, S::kNone, S::kFragment, S::kEpisode, S::kEpisode, S::kNone,
                                            S::kLane, S::kNone, S::kFragment, S::kNone}));
  for (size_t i = 0; i < fragments.size(); ++i) {
    EXPECT_EQ(rollout.states[2 * i], fragments[i].states.data());
    EXPECT_EQ(rollout.states[2 * i + 1], nullptr);
  }
}

TEST(Rollout, EveryStepHasItsStateWhereFragmentsHoldIt) {
  Fragment fragment = TwoSteps();
  fragment.states = {1, 2, 3, 4};
  RolloutOptions options = Options();
  options.every_state = true;
  Rollout rollout;
  AppendFragment(fragment, options, &rollout);
  EXPECT_EQ(rollout.states[0], &fragment.states[0]);
  EXPECT_EQ(rollout.states[1], &fragment.states[2]);
}

}  // namespace rollout_test
}  // namespace craftfleet
