#include "learner/ppo/lag_correction.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include <gtest/gtest.h>

#include "learner/ppo/ppo_loss.h"

namespace craftfleet {
namespace {

using Floats = std::vector<float>;

constexpr GaeOptions kGae = {0.5, 0.5, false};

v1::PpoConfig Config() {
  v1::PpoConfig config;
  config.set_gamma(kGae.gamma);
  config.set_gae_lambda(kGae.lambda);
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
  EstimateAdvantages(kGae, &rollout);
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

TEST(LagCorrection, IsMadeWhereOlderWeightsPlayAndItCostsNothing) {
  using Network = v1::NetworkConfig;
  const auto corrects = [](int overlap, int max_staleness, int epochs, double dropout,
                           Network::ObjectModule objects = Network::SELF_ATTENTION) {
    v1::RunConfig config;
    config.set_overlap(overlap);
    config.set_max_staleness(max_staleness);
    config.mutable_ppo()->set_epochs(epochs);
    Network network;
    network.set_objects(objects);
    network.set_dropout(dropout);
    return CorrectsLag(config, network);
  };
  EXPECT_TRUE(corrects(1, 0, 2, 0));
  EXPECT_TRUE(corrects(0, 2, 4, 0));
  EXPECT_FALSE(corrects(0, 0, 4, 0)) << "a synchronous run";
  EXPECT_FALSE(corrects(1, 0, 1, 0)) << "a single epoch";
  EXPECT_FALSE(corrects(0, 2, 4, 0.1)) << "dropout";
  EXPECT_TRUE(corrects(0, 2, 4, 0.1, Network::NO_OBJECTS)) << "the preset's, of a part that the network does not have";
}

TEST(LagCorrection, AnImplausibleLogProbabilityHasAFiniteWeight) {
  Rollout rollout = FourSteps();
  rollout.log_probs[1] = -104;
  const CorrectedRollout corrected = CorrectLag(rollout, Start({1, 1, 1, 1}), Config());
  for (const float weight : corrected.rollout.weights) EXPECT_LT(weight, 1e9);
}

TEST(LagCorrection, RatiosAreToTheStartAndWeighted) {
  const Rollout rollout = FourSteps();
  const StartOutputs start = Start({0.5, 1, 2, 4});
  const CorrectedRollout corrected = CorrectLag(rollout, start, Config());
  EXPECT_EQ(corrected.rollout.log_probs, start.log_probs);
  ExpectNear(corrected.rollout.weights, {0.5, 1, 2, 4}, 1e-6);
  EXPECT_EQ(corrected.rollout.advantages, rollout.advantages);
  EXPECT_EQ(corrected.rollout.returns, rollout.returns);
  EXPECT_NEAR(corrected.importance.mean, 1.875, 1e-6);
  EXPECT_NEAR(corrected.importance.min, 0.5, 1e-6);
  EXPECT_NEAR(corrected.importance.max, 4, 1e-6);
}

// By hand: deltas 1 + 11 - 11 = 1 and 2 + 4 - 22 = -16; 3 + 30 - 33 = 0, cut off, and 4 + 6 - 44 = -34. What was played
// remains where the start says nothing: after the last step of a lane and of an episode that was cut off.
TEST(LagCorrection, ValuesAreTheStarts) {
  StartOutputs start = Start({0.5, 1, 2, 4});
  start.values = {11, 22, 33, 44};
  const CorrectedRollout corrected = CorrectLag(FourSteps(), start, Config());
  EXPECT_EQ(corrected.rollout.values, start.values);
  ExpectNear(corrected.rollout.advantages, {1 + 0.25F * -16, -16, 0, -34}, 1e-5);
  ExpectNear(corrected.rollout.returns, {11 - 3, 22 - 16, 33, 44 - 34}, 1e-5);
}

// Where the next fragment continues the lane, its first value is the bootstrap value of the one before.
TEST(LagCorrection, TheValueAfterAFragmentIsTheStarts) {
  Rollout rollout = FourSteps();
  rollout.starts[2] = RowStart::kFragment;
  StartOutputs start = Start({1, 1, 1, 1});
  start.values = {11, 22, 33, 44};
  const CorrectedRollout corrected = CorrectLag(rollout, start, Config());
  ExpectNear(corrected.rollout.returns, {11 + 1 + 0.25F * (2 + 16.5F - 22), 2 + 16.5F, 33, 44 - 34}, 1e-5);
}

// Hilton et al. 2021, equation 3, row by row: w * min(A q, A clamp(q)) with q to the policy that the update starts
// from.
TEST(LagCorrection, TheLossIsTheDecoupledOneAsByHand) {
  CorrectedRollout corrected = CorrectLag(FourSteps(), Start({0.5, 1, 2, 4}), Config());
  const Floats played = {1, -1, 2, -2};
  Floats advantages = played;
  for (int i = 0; i < 4; ++i) advantages[i] *= corrected.rollout.weights[i];
  // All actions are as likely now: 1/17.
  const Floats logits(4 * kNumActions);
  const Floats zeros(4);
  Floats by_logits(4 * kNumActions);
  Floats by_values(4);
  v1::PpoConfig loss_config;
  loss_config.set_clip(0.2);
  const PpoLossSums sums =
      PpoLoss(logits, zeros, {corrected.rollout.actions, corrected.rollout.log_probs, advantages, zeros}, loss_config,
              1, absl::MakeSpan(by_logits), absl::MakeSpan(by_values));
  double loss = 0;
  const double weights[] = {0.5, 1, 2, 4};
  for (int i = 0; i < 4; ++i) {
    const double q = (1.0 / 17) / (weights[i] * std::exp(-1));
    const double a = played[i];
    loss -= weights[i] * std::min(a * q, a * std::clamp(q, 0.8, 1.2));
  }
  EXPECT_NEAR(sums.policy_loss, loss, 1e-5);
}

}  // namespace
}  // namespace craftfleet
