#include "learner/ppo/lag_correction.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include <gtest/gtest.h>

#include "common/base/keyed_random.h"
#include "learner/ppo/ppo_loss.h"

namespace craftfleet {
namespace {

using Floats = std::vector<float>;

constexpr GaeOptions kGae = {0.5, 0.5, false, /*rho_bar=*/1.5, /*c_bar=*/1};

v1::PpoConfig Config(bool decoupled, bool vtrace) {
  v1::PpoConfig config;
  if (decoupled) config.set_decoupled_objective(true);
  if (vtrace) config.set_vtrace_rho_bar(kGae.rho_bar);
  if (vtrace) config.set_vtrace_c_bar(kGae.c_bar);
  return config;
}

// Two fragments of two steps; an episode of the second is cut off at its first step.
Rollout FourSteps() {
  Rollout rollout;
  rollout.actions.resize(4);
  rollout.log_probs = {-1, -1, -1, -1};
  rollout.values = {10, 20, 30, 40};
  rollout.rewards = {1, 2, 3, 4};
  rollout.ends = {StepEnd::kNone, StepEnd::kNone, StepEnd::kTruncated, StepEnd::kNone};
  rollout.fragments = {{0, 2, 8, {}}, {2, 2, 12, {60}}};
  rollout.advantages.resize(4);
  rollout.returns.resize(4);
  EstimateAdvantages(kGae, {}, &rollout);
  return rollout;
}

// Log-probabilities that are `ratios` times as likely as FourSteps'.
Floats LogProbs(const std::vector<double>& ratios) {
  Floats log_probs;
  for (const double ratio : ratios) log_probs.push_back(static_cast<float>(-1 + std::log(ratio)));
  return log_probs;
}

void ExpectNear(const Floats& actual, const Floats& wanted, double tolerance) {
  ASSERT_EQ(actual.size(), wanted.size());
  for (size_t i = 0; i < wanted.size(); ++i) EXPECT_NEAR(actual[i], wanted[i], tolerance) << i;
}

TEST(LagCorrection, IsWantedByEitherField) {
  EXPECT_FALSE(CorrectsLag(Config(false, false)));
  EXPECT_TRUE(CorrectsLag(Config(true, false)));
  EXPECT_TRUE(CorrectsLag(Config(false, true)));
}

TEST(LagCorrection, AMadeUpLogProbabilityHasAFiniteWeight) {
  Rollout rollout = FourSteps();
  rollout.log_probs[1] = -104;
  const CorrectedRollout corrected = CorrectLag(rollout, LogProbs({1, 1, 1, 1}), Config(true, true), kGae);
  for (const float weight : corrected.rollout.weights) EXPECT_LT(weight, 1e9);
}

TEST(LagCorrection, DecoupledRatiosAreWeighted) {
  const Rollout rollout = FourSteps();
  const Floats log_probs = LogProbs({0.5, 1, 2, 4});
  const CorrectedRollout corrected = CorrectLag(rollout, log_probs, Config(true, false), kGae);
  EXPECT_EQ(corrected.rollout.log_probs, log_probs);
  ExpectNear(corrected.rollout.weights, {0.5, 1, 2, 4}, 1e-6);
  EXPECT_EQ(corrected.rollout.advantages, rollout.advantages);
  EXPECT_EQ(corrected.rollout.returns, rollout.returns);
  EXPECT_NEAR(corrected.importance.mean, 1.875, 1e-6);
  EXPECT_NEAR(corrected.importance.min, 0.5, 1e-6);
  EXPECT_NEAR(corrected.importance.max, 4, 1e-6);
}

// By hand, with gamma * lambda = 0.25 and weights 0.5, 1, 2 and 4, cut off at 1.5 and 1:
//   fragment 1: deltas 1 + 10 - 10 = 1 and 2 + 4 - 20 = -14; errors -14 and 0.5 * 1 + 0.5 * 0.25 * -14 = -1.25
//   fragment 2: deltas 3 + 30 - 30 = 3 and 4 + 6 - 40 = -30; errors 1.5 * -30 = -45 and, nothing follows, 1.5 * 3 = 4.5
TEST(LagCorrection, VTraceIsAsByHand) {
  const Rollout rollout = FourSteps();
  EXPECT_EQ(rollout.advantages, (Floats{1 + 0.25F * -14, -14, 3, -30}));
  const CorrectedRollout corrected = CorrectLag(rollout, LogProbs({0.5, 1, 2, 4}), Config(false, true), kGae);
  EXPECT_EQ(corrected.rollout.log_probs, rollout.log_probs);
  EXPECT_TRUE(corrected.rollout.weights.empty());
  ExpectNear(corrected.rollout.advantages, {1 + 0.25F * -14, -14, 3, -30}, 1e-5);
  ExpectNear(corrected.rollout.returns, {10 - 1.25F, 20 - 14, 30 + 4.5F, 40 - 45}, 1e-5);
}

// An action's own weight is not part of its advantage, whose ratio has it already; those of later actions are.
TEST(LagCorrection, AnAdvantageHasTheWeightsOfWhatFollows) {
  const CorrectedRollout corrected = CorrectLag(FourSteps(), LogProbs({9, 0.5, 1, 1}), Config(false, true), kGae);
  ExpectNear(corrected.rollout.advantages, {1 + 0.25F * 0.5F * -14, -14, 3, -30}, 1e-5);
}

TEST(LagCorrection, OnPolicyNothingChangesAndWeightsAreOne) {
  const Rollout rollout = FourSteps();
  const CorrectedRollout corrected = CorrectLag(rollout, rollout.log_probs, Config(true, true), kGae);
  EXPECT_EQ(corrected.rollout.log_probs, rollout.log_probs);
  EXPECT_EQ(corrected.rollout.weights, Floats(4, 1));
  EXPECT_EQ(corrected.rollout.advantages, rollout.advantages);
  EXPECT_EQ(corrected.rollout.returns, rollout.returns);
  EXPECT_EQ(corrected.importance.mean, 1);
  EXPECT_EQ(corrected.importance.min, 1);
  EXPECT_EQ(corrected.importance.max, 1);
}

// Hilton et al. 2021, equation 3, row by row: w * min(A q, A clamp(q)) with q to the policy that the update starts
// from.
TEST(LagCorrection, TheLossIsTheDecoupledOneAsByHand) {
  Rollout rollout = FourSteps();
  rollout.advantages = {1, -1, 2, -2};
  const CorrectedRollout corrected = CorrectLag(rollout, LogProbs({0.5, 1, 2, 4}), Config(true, false), kGae);
  Floats advantages = corrected.rollout.advantages;
  for (int i = 0; i < 4; ++i) advantages[i] *= corrected.rollout.weights[i];
  // All actions are as likely now: 1/17.
  const Floats logits(4 * kNumActions);
  const Floats zeros(4);
  Floats by_logits(4 * kNumActions);
  Floats by_values(4);
  const PpoLossSums sums = PpoLoss(logits, zeros, {rollout.actions, corrected.rollout.log_probs, advantages, zeros},
                                   {0.2, 0, 0}, 1, absl::MakeSpan(by_logits), absl::MakeSpan(by_values));
  double loss = 0;
  const double weights[] = {0.5, 1, 2, 4};
  for (int i = 0; i < 4; ++i) {
    const double q = (1.0 / 17) / (weights[i] * std::exp(-1));
    const double a = rollout.advantages[i];
    loss -= weights[i] * std::min(a * q, a * std::clamp(q, 0.8, 1.2));
  }
  EXPECT_NEAR(sums.policy_loss, loss, 1e-5);
}

// Weights beyond the bounds count as the bounds; smaller weights never enlarge an error.
TEST(LagCorrection, TruncatedWeightsStayWithinTheirBounds) {
  constexpr int kSteps = 32;
  for (int trial = 0; trial < 50; ++trial) {
    const auto uniform = [&](int step, int k) { return static_cast<float>(ActionNoise(trial, step, k)); };
    Rollout rollout;
    std::vector<double> ratios;
    std::vector<double> bounded;
    for (int t = 0; t < kSteps; ++t) {
      rollout.actions.push_back(Action{});
      rollout.rewards.push_back(uniform(t, 0));
      rollout.values.push_back(0);
      rollout.ends.push_back(uniform(t, 1) < 0.1F ? StepEnd::kTerminated : StepEnd::kNone);
      ratios.push_back(std::exp(6 * uniform(t, 2) - 3));
      bounded.push_back(std::min(ratios.back(), kGae.rho_bar));
    }
    rollout.fragments = {{0, kSteps, uniform(0, 3), {}}};
    rollout.advantages.resize(kSteps);
    rollout.returns.resize(kSteps);
    Rollout on_policy = rollout;
    Rollout cut = rollout;
    EstimateAdvantages(kGae, ratios, &rollout);
    EstimateAdvantages(kGae, bounded, &cut);
    EstimateAdvantages(kGae, {}, &on_policy);
    EXPECT_EQ(rollout.returns, cut.returns);
    EXPECT_EQ(rollout.advantages, cut.advantages);
    for (int t = 0; t < kSteps; ++t) {
      // Rewards are not negative and values are 0, so each error is a sum of terms that are not negative.
      EXPECT_GE(rollout.returns[t], 0);
      EXPECT_LE(rollout.returns[t], kGae.rho_bar * on_policy.returns[t] * (1 + 1e-6));
    }
  }
}

}  // namespace
}  // namespace craftfleet
