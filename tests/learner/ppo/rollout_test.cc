#include "learner/ppo/rollout.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace craftfleet {
namespace {

constexpr int kFrameBytes = 12;

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
  return fragment;
}

TEST(Rollout, AppendsTheFragmentsStepsWithTheirAdvantages) {
  const Fragment first = TwoSteps();
  const Fragment second = TwoSteps();
  Rollout rollout;
  const GaeOptions gae = {0.5, 0.5, false};
  ASSERT_TRUE(AppendFragment(first, kFrameBytes, gae, &rollout).ok());
  ASSERT_TRUE(AppendFragment(second, kFrameBytes, gae, &rollout).ok());
  ASSERT_EQ(rollout.size(), 4);
  EXPECT_EQ(rollout.frames[1], reinterpret_cast<const uint8_t*>(first.frames.data()) + kFrameBytes);
  EXPECT_EQ(rollout.frames[2], reinterpret_cast<const uint8_t*>(second.frames.data()));
  EXPECT_EQ(rollout.actions[3], Action::kMakeIronSword);
  EXPECT_EQ(rollout.log_probs, (std::vector<float>{-1, -2, -1, -2}));
  EXPECT_EQ(rollout.values, (std::vector<float>{10, 20, 10, 20}));
  EXPECT_EQ(rollout.advantages, (std::vector<float>{1 + 10 - 10 - 4.5, -18, 1 + 10 - 10 - 4.5, -18}));
  EXPECT_EQ(rollout.returns, (std::vector<float>{6.5, 2, 6.5, 2}));
}

TEST(Rollout, RefusesAFragmentWhoseFieldsDisagree) {
  const auto error_of = [](void (*spoil)(Fragment*)) {
    Fragment fragment = TwoSteps();
    spoil(&fragment);
    Rollout rollout;
    const absl::Status status = AppendFragment(fragment, kFrameBytes, {}, &rollout);
    EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument);
    EXPECT_EQ(rollout.size(), 0);
    return status.ToString();
  };
  using ::testing::HasSubstr;
  EXPECT_THAT(error_of([](Fragment* f) { f->frames.pop_back(); }),
              HasSubstr("23 bytes of frames for 2 steps, want 24"));
  EXPECT_THAT(error_of([](Fragment* f) { f->log_probs.pop_back(); }), HasSubstr("1 log_probs"));
  EXPECT_THAT(error_of([](Fragment* f) { f->values.pop_back(); }), HasSubstr("1 values"));
  EXPECT_THAT(error_of([](Fragment* f) { f->rewards.push_back(0); }), HasSubstr("3 rewards"));
  EXPECT_THAT(error_of([](Fragment* f) { f->ends.pop_back(); }), HasSubstr("1 ends"));
  EXPECT_THAT(error_of([](Fragment* f) { f->ends[0] = StepEnd::kTruncated; }), HasSubstr("0 truncation_values"));
  EXPECT_THAT(error_of([](Fragment* f) { f->actions[1] = 17; }),
              HasSubstr("fragment 9 of lane 3: action 17, want 0..16"));
}

}  // namespace
}  // namespace craftfleet
