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

v1::PpoConfig Config(bool decoupled, bool vtrace, bool recompute = false) {
  v1::PpoConfig config;
  config.set_gamma(kGae.gamma);
  config.set_gae_lambda(kGae.lambda);
  if (recompute) config.set_recompute_values(true);
  if (decoupled) config.set_decoupled_objective(true);
  if (vtrace) config.set_vtrace_rho_bar(kGae.rho_bar);
  if (vtrace) config.set_vtrace_c_bar(kGae.c_bar);
  return config;
}

// Two fragments of two steps, of two lanes; an episode of the second is cut off at its first step.
Rollout FourSteps() {
  Rollout rollout;
  rollout.actions.resize(4);
  rollout.log_probs = {-1, -1, -1, -1};
  rollout.values = {10, 20, 30, 40};
  rollout.rewards = {1, 2, 3, 4};
  rollout.ends = {StepEnd::kNone, StepEnd::kNone, StepEnd::kTruncated, StepEnd::kNone};
  rollout.starts = {RowStart::kEpisode, RowStart::kNone, RowStart::kLane, RowStart::kEpisode};
  rollout.fragments = {{0, 2, 8, {}}, {2, 2, 12, {60}}};
  rollout.advantages.resize(4);
  rollout.returns.resize(4);
  EstimateAdvantages(kGae, {}, &rollout);
  return rollout;
}

// The start makes FourSteps' actions `ratios` times as likely, and has the values that were played.
StartOutputs Start(const std::vector<double>& ratios) {
  StartOutputs start(ratios.size());
  start.values = FourSteps().values;
  for (size_t i = 0; i < ratios.size(); ++i) start.log_probs[i] = static_cast<float>(-1 + std::log(ratios[i]));
  return start;
}

void ExpectNear(const Floats& actual, const Floats& wanted, double tolerance) {
  ASSERT_EQ(actual.size(), wanted.size());
  for (size_t i = 0; i < wanted.size(); ++i) EXPECT_NEAR(actual[i], wanted[i], tolerance) << i;
}

TEST(LagCorrection, IsMadeInTheFirstOfSeveralEpochsUnlessAPassIsWanted) {
  const auto correction_of = [](v1::PpoConfig config, int epochs, bool pass = false) {
    config.set_epochs(epochs);
    config.set_correction_pass(pass);
    return LagCorrectionOf(config);
  };
  for (const int epochs : {1, 4}) {
    EXPECT_EQ(correction_of(Config(false, false), epochs), LagCorrection::kNone);
    EXPECT_EQ(correction_of(Config(false, false), epochs, true), LagCorrection::kNone);
  }
  for (const v1::PpoConfig& config : {Config(true, false), Config(false, true), Config(false, false, true)}) {
    EXPECT_EQ(correction_of(config, 1), LagCorrection::kBefore);
    EXPECT_EQ(correction_of(config, 4), LagCorrection::kInFirstEpoch);
    EXPECT_EQ(correction_of(config, 4, true), LagCorrection::kBefore);
  }
}

TEST(LagCorrection, AMadeUpLogProbabilityHasAFiniteWeight) {
  Rollout rollout = FourSteps();
  rollout.log_probs[1] = -104;
  const CorrectedRollout corrected = CorrectLag(rollout, Start({1, 1, 1, 1}), Config(true, true));
  for (const float weight : corrected.rollout.weights) EXPECT_LT(weight, 1e9);
}

TEST(LagCorrection, DecoupledRatiosAreWeighted) {
  const Rollout rollout = FourSteps();
  const StartOutputs start = Start({0.5, 1, 2, 4});
  const CorrectedRollout corrected = CorrectLag(rollout, start, Config(true, false));
  EXPECT_EQ(corrected.rollout.log_probs, start.log_probs);
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
  const CorrectedRollout corrected = CorrectLag(rollout, Start({0.5, 1, 2, 4}), Config(false, true));
  EXPECT_EQ(corrected.rollout.log_probs, rollout.log_probs);
  EXPECT_TRUE(corrected.rollout.weights.empty());
  ExpectNear(corrected.rollout.advantages, {1 + 0.25F * -14, -14, 3, -30}, 1e-5);
  ExpectNear(corrected.rollout.returns, {10 - 1.25F, 20 - 14, 30 + 4.5F, 40 - 45}, 1e-5);
}

// By hand: deltas 1 + 11 - 11 = 1 and 2 + 4 - 22 = -16; 3 + 30 - 33 = 0, cut off, and 4 + 6 - 44 = -34. What was played
// remains where the start says nothing: after the last step of a lane and of an episode that was cut off.
TEST(LagCorrection, ValuesAreTheStarts) {
  StartOutputs start = Start({0.5, 1, 2, 4});
  start.values = {11, 22, 33, 44};
  const CorrectedRollout corrected = CorrectLag(FourSteps(), start, Config(false, false, true));
  EXPECT_EQ(corrected.rollout.values, start.values);
  EXPECT_EQ(corrected.rollout.log_probs, FourSteps().log_probs);
  EXPECT_TRUE(corrected.rollout.weights.empty());
  ExpectNear(corrected.rollout.advantages, {1 + 0.25F * -16, -16, 0, -34}, 1e-5);
  ExpectNear(corrected.rollout.returns, {11 - 3, 22 - 16, 33, 44 - 34}, 1e-5);
}

// Where the next fragment continues the lane, its first value is the bootstrap value of the one before.
TEST(LagCorrection, TheValueAfterAFragmentIsTheStarts) {
  Rollout rollout = FourSteps();
  rollout.starts[2] = RowStart::kFragment;
  StartOutputs start = Start({1, 1, 1, 1});
  start.values = {11, 22, 33, 44};
  const CorrectedRollout corrected = CorrectLag(rollout, start, Config(false, false, true));
  ExpectNear(corrected.rollout.returns, {11 + 1 + 0.25F * (2 + 16.5F - 22), 2 + 16.5F, 33, 44 - 34}, 1e-5);
}

// 1.5 and 1 bound the weights: fragment 1 has errors -16 and 0.5 * 1 + 0.5 * 0.25 * -16 = -1.5.
TEST(LagCorrection, VTraceTakesTheStartsValuesIfTheyAreWanted) {
  StartOutputs start = Start({0.5, 1, 2, 4});
  start.values = {11, 22, 33, 44};
  const CorrectedRollout corrected = CorrectLag(FourSteps(), start, Config(false, true, true));
  ExpectNear(corrected.rollout.returns, {11 - 1.5F, 22 - 16, 33, 44 - 1.5F * 34}, 1e-5);
}

// An action's own weight is not part of its advantage, whose ratio has it already; those of later actions are.
TEST(LagCorrection, AnAdvantageHasTheWeightsOfWhatFollows) {
  const CorrectedRollout corrected = CorrectLag(FourSteps(), Start({9, 0.5, 1, 1}), Config(false, true));
  ExpectNear(corrected.rollout.advantages, {1 + 0.25F * 0.5F * -14, -14, 3, -30}, 1e-5);
}

TEST(LagCorrection, OnPolicyNothingChangesAndWeightsAreOne) {
  const Rollout rollout = FourSteps();
  const CorrectedRollout corrected = CorrectLag(rollout, Start({1, 1, 1, 1}), Config(true, true, true));
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
  const CorrectedRollout corrected = CorrectLag(rollout, Start({0.5, 1, 2, 4}), Config(true, false));
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
