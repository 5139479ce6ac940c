#include "learner/ppo/ppo_loss.h"

#include <cmath>
#include <vector>

#include <ATen/ATen.h>
#include <gtest/gtest.h>

#include "common/agent/torch_setup.h"
#include "common/base/keyed_random.h"
#include "learner/ppo/device_loss.h"

namespace craftfleet {
namespace ppo_loss_test {

constexpr int kRows = 24;

float Random(int i, int k) { return static_cast<float>(ActionNoise(1, i, k) * 2 - 1); }

// Random rows, among them ratios on both sides of the clip range for both signs of the advantage.
struct Example {
  std::vector<float> logits, values, log_probs, advantages, returns;
  std::vector<Action> actions;

  Example() {
    for (int row = 0; row < kRows; ++row) {
      for (int i = 0; i < kNumActions; ++i) logits.push_back(Random(row, i));
      values.push_back(Random(row, 100));
      actions.push_back(static_cast<Action>(row % kNumActions));
      log_probs.push_back(-2.8F + Random(row, 101));
      advantages.push_back(Random(row, 102));
      returns.push_back(Random(row, 103));
    }
  }

  PpoTargets targets() const { return {actions, log_probs, advantages, returns}; }
};

v1::PpoConfig Config(double entropy_coefficient) {
  v1::PpoConfig config;
  config.set_clip(0.2);
  config.set_value_coefficient(0.5);
  config.set_entropy_coefficient(entropy_coefficient);
  return config;
}

double TotalLoss(const Example& example) {
  std::vector<float> by_logits(kRows * kNumActions);
  std::vector<float> by_values(kRows);
  const PpoLossSums sums = PpoLoss(example.logits, example.values, example.targets(), Config(0.01), kRows,
                                   absl::MakeSpan(by_logits), absl::MakeSpan(by_values));
  return (sums.policy_loss + 0.5 * sums.value_loss - 0.01 * sums.entropy) / kRows;
}

// Slope of the loss along `x`, which belongs to `example`.
double Slope(Example* example, float* x) {
  constexpr float kStep = 0x1p-9F;
  const float middle = *x;
  *x = middle + kStep;
  const double above = TotalLoss(*example);
  *x = middle - kStep;
  const double below = TotalLoss(*example);
  *x = middle;
  return (above - below) / (2 * kStep);
}

TEST(PpoLoss, GradientIsTheSlopeOfTheLoss) {
  Example example;
  std::vector<float> by_logits(kRows * kNumActions);
  std::vector<float> by_values(kRows);
  PpoLoss(example.logits, example.values, example.targets(), Config(0.01), kRows, absl::MakeSpan(by_logits),
          absl::MakeSpan(by_values));
  for (size_t i = 0; i < by_logits.size(); ++i) EXPECT_NEAR(by_logits[i], Slope(&example, &example.logits[i]), 2e-6);
  for (size_t i = 0; i < by_values.size(); ++i) EXPECT_NEAR(by_values[i], Slope(&example, &example.values[i]), 2e-6);
}

TEST(PpoLoss, ClipsOnlyWhereItTakesAwayGain) {
  // One action is certain to matter: ratio e^0.5 = 1.65, beyond 1.2.
  std::vector<float> logits(kNumActions, 0.0F);
  const std::vector<float> values = {0};
  const std::vector<Action> actions = {Action::kDo};
  const std::vector<float> log_probs = {static_cast<float>(-std::log(17.0) - 0.5)};
  const std::vector<float> returns = {0};
  for (const float advantage : {2.0F, -2.0F}) {
    const std::vector<float> advantages = {advantage};
    std::vector<float> by_logits(kNumActions);
    std::vector<float> by_values(1);
    const PpoLossSums sums = PpoLoss(logits, values, {actions, log_probs, advantages, returns}, Config(0), 1,
                                     absl::MakeSpan(by_logits), absl::MakeSpan(by_values));
    EXPECT_EQ(sums.clipped, 1);
    EXPECT_NEAR(sums.policy_loss, advantage > 0 ? -2.4 : 2 * std::exp(0.5), 1e-5);
    EXPECT_NEAR(sums.approx_kl, std::exp(0.5) - 1 - 0.5, 1e-6);
    EXPECT_NEAR(by_logits[5], advantage > 0 ? 0 : 2 * std::exp(0.5) * 16 / 17, 1e-5);
  }
}

// The lowest log probability that a learner accepts from an actor used to overflow the gradient and end the run.
TEST(PpoLoss, AMadeUpLogProbabilityKeepsTheGradientFinite) {
  const std::vector<float> logits(kNumActions, 0.0F);
  const std::vector<float> values = {0};
  const std::vector<Action> actions = {Action::kDo};
  const std::vector<float> log_probs = {-104};
  const std::vector<float> advantages = {-8};
  const std::vector<float> returns = {0};
  std::vector<float> by_logits(kNumActions);
  std::vector<float> by_values(1);
  PpoLoss(logits, values, {actions, log_probs, advantages, returns}, Config(0), 1, absl::MakeSpan(by_logits),
          absl::MakeSpan(by_values));
  double squares = 0;
  for (const float x : by_logits) squares += double{x} * x;
  EXPECT_GT(squares, 0);
  EXPECT_LT(squares, 1e30) << "far from the largest float, also after the network's layers";
}

TEST(PpoLoss, PartsOfABatchAddUpToTheWhole) {
  const Example example;
  std::vector<float> by_logits(kRows * kNumActions);
  std::vector<float> by_values(kRows);
  const PpoLossSums whole = PpoLoss(example.logits, example.values, example.targets(), Config(0.01), kRows,
                                    absl::MakeSpan(by_logits), absl::MakeSpan(by_values));
  PpoLossSums sum;
  for (const size_t first : {size_t{0}, size_t{kRows / 2}}) {
    const auto part = [&](const auto& values, size_t width) {
      return absl::MakeConstSpan(values).subspan(first * width, kRows / 2 * width);
    };
    std::vector<float> part_by_logits(kRows / 2 * kNumActions);
    std::vector<float> part_by_values(kRows / 2);
    sum.Add(PpoLoss(
        part(example.logits, kNumActions), part(example.values, 1),
        {part(example.actions, 1), part(example.log_probs, 1), part(example.advantages, 1), part(example.returns, 1)},
        Config(0.01), kRows, absl::MakeSpan(part_by_logits), absl::MakeSpan(part_by_values)));
    EXPECT_EQ(absl::MakeConstSpan(part_by_logits), part(by_logits, kNumActions));
    EXPECT_EQ(absl::MakeConstSpan(part_by_values), part(by_values, 1));
  }
  EXPECT_NEAR(sum.policy_loss, whole.policy_loss, 1e-12);
  EXPECT_NEAR(sum.value_loss, whole.value_loss, 1e-12);
  EXPECT_NEAR(sum.entropy, whole.entropy, 1e-12);
  EXPECT_NEAR(sum.approx_kl, whole.approx_kl, 1e-12);
  EXPECT_EQ(sum.clipped, whole.clipped);
}

TEST(Normalise, GivesMeanZeroAndSampleDeviationOne) {
  std::vector<float> values = {1, 2, 3, 4};
  Normalise(absl::MakeSpan(values));
  const double deviation = std::sqrt(5.0 / 3.0);
  for (int i = 0; i < 4; ++i) EXPECT_NEAR(values[i], (i - 1.5) / deviation, 1e-6);
  std::vector<float> equal = {5, 5, 5};
  Normalise(absl::MakeSpan(equal));
  EXPECT_EQ(equal, (std::vector<float>{0, 0, 0}));
}

TEST(DeviceLoss, IsTheCpus) {
  SetUpTorchThread();
  at::manual_seed(3);
  constexpr int kRowsHere = 50;
  const at::Tensor logits = at::randn({kRowsHere, kNumActions});
  const at::Tensor values = at::randn({kRowsHere});
  const at::Tensor actions = at::randint(0, kNumActions, {kRowsHere}, at::kLong);
  const at::Tensor log_probs = at::log_softmax(logits, 1).gather(1, actions.unsqueeze(1)).squeeze(1) +
                               at::randn({kRowsHere}) * 0.2;  // some ratios are clipped, some are not
  const at::Tensor returns = at::randn({kRowsHere});
  std::vector<float> advantages(kRowsHere);
  for (int i = 0; i < kRowsHere; ++i) advantages[i] = static_cast<float>(ActionNoise(1, i, 0)) - 0.3F;
  const at::Tensor normalised = NormaliseOnDevice(at::tensor(advantages));
  Normalise(absl::MakeSpan(advantages));
  EXPECT_TRUE(at::allclose(normalised, at::tensor(advantages), 1e-6, 1e-7));

  const auto floats = [](const at::Tensor& x) { return absl::MakeSpan(x.data_ptr<float>(), x.numel()); };
  std::vector<Action> chosen;
  for (int i = 0; i < kRowsHere; ++i) chosen.push_back(static_cast<Action>(actions[i].item<int64_t>()));
  const v1::PpoConfig config = Config(0.03);
  const at::Tensor by_logits = at::empty_like(logits);
  const at::Tensor by_values = at::empty_like(values);
  const PpoLossSums sums =
      PpoLoss(floats(logits), floats(values), {chosen, floats(log_probs), advantages, floats(returns)}, config,
              kRowsHere, floats(by_logits), floats(by_values));
  EXPECT_GT(sums.clipped, 5);
  EXPECT_LT(sums.clipped, 45);
  const DeviceLoss loss =
      PpoLossOnDevice(logits, values, {actions, log_probs, at::tensor(advantages), returns}, config);
  EXPECT_TRUE(at::allclose(loss.by_logits, by_logits, 1e-5, 1e-8));
  EXPECT_TRUE(at::allclose(loss.by_values, by_values, 1e-5, 1e-8));
  const double expected[] = {sums.policy_loss, sums.value_loss, sums.entropy, sums.approx_kl, sums.clipped};
  for (int i = 0; i < 5; ++i) EXPECT_NEAR(loss.means[i].item<double>(), expected[i] / kRowsHere, 1e-9) << i;
}

// As PpoLoss.AMadeUpLogProbabilityKeepsTheGradientFinite.
TEST(DeviceLoss, AMadeUpLogProbabilityKeepsTheGradientFinite) {
  SetUpTorchThread();
  const at::Tensor zero = at::zeros({1});
  const DeviceTargets targets = {at::zeros({1}, at::kLong), at::full({1}, -104.0F), at::full({1}, -8.0F), zero};
  const DeviceLoss loss = PpoLossOnDevice(at::zeros({1, kNumActions}), zero, targets, Config(0));
  EXPECT_GT(loss.by_logits.abs().max().item<double>(), 0);
  EXPECT_LT(loss.by_logits.abs().max().item<double>(), 1e15);
}

}  // namespace ppo_loss_test
}  // namespace craftfleet
