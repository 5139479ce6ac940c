#include "learner/ppo/adam.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include <ATen/ATen.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/string_view.h>
#include <gtest/gtest.h>

#include "common/agent/policy_net.h"
#include "common/agent/torch_setup.h"
#include "common/base/keyed_random.h"
#include "learner/ppo/device_adam.h"
#include "tests/agent/golden_agent.h"
#include "tests/agent/stand_in_device.h"

namespace craftfleet {
namespace {

constexpr size_t kPieces[] = {1, 40000, 7, 16384};  // one longer than a block, one as long

// A gradient in pieces, with the memory under it.
struct Gradient {
  std::vector<float> values;
  ShardGradient pieces;

  explicit Gradient(int seed, float scale) {
    size_t size = 0;
    for (const size_t piece : kPieces) size += piece;
    for (size_t i = 0; i < size; ++i) {
      values.push_back(scale * (static_cast<float>(ActionNoise(seed, 0, static_cast<int64_t>(i))) - 0.4F));
    }
    size_t offset = 0;
    for (const size_t piece : kPieces) {
      pieces.push_back(absl::MakeSpan(values).subspan(offset, piece));
      offset += piece;
    }
  }
};

v1::PpoConfig AdamConfig(double max_gradient_norm) {
  v1::PpoConfig config;
  config.set_learning_rate(3e-4);
  config.set_adam_epsilon(1e-5);
  config.set_max_gradient_norm(max_gradient_norm);
  return config;
}

AdamState FreshState(size_t size) { return {0, std::vector<float>(size), std::vector<float>(size)}; }

TEST(Adam, FollowsThePublishedFormulas) {
  const v1::PpoConfig config = AdamConfig(1e9);
  WorkerPool workers(1, [] {});
  const size_t size = Gradient(1, 1).values.size();
  std::vector<float> weights(size, 1.0F);
  AdamState state = FreshState(size);
  std::vector<double> expected(size, 1.0);
  std::vector<double> m(size);
  std::vector<double> v(size);
  for (int t = 1; t <= 5; ++t) {
    Gradient first(t, 1);
    Gradient second(100 + t, 1);
    double squares = 0;
    for (size_t i = 0; i < size; ++i) {
      const double g = first.values[i] + second.values[i];
      squares += g * g;
      m[i] = 0.9 * m[i] + 0.1 * g;
      v[i] = 0.999 * v[i] + 0.001 * g * g;
      expected[i] -= 3e-4 * (m[i] / (1 - std::pow(0.9, t))) / (std::sqrt(v[i] / (1 - std::pow(0.999, t))) + 1e-5);
    }
    const std::vector<ShardGradient> shards = {first.pieces, second.pieces};
    EXPECT_NEAR(AdamStep(config, shards, absl::MakeSpan(weights), &state, &workers), std::sqrt(squares), 1e-4);
    EXPECT_EQ(state.steps, t);
  }
  for (size_t i = 0; i < size; ++i) ASSERT_NEAR(weights[i], expected[i], 1e-6) << i;
}

TEST(Adam, ClipsByTheGlobalNorm) {
  WorkerPool workers(1, [] {});
  const v1::PpoConfig config = AdamConfig(0.5);
  for (const float scale : {100.0F, 1e-6F}) {
    Gradient gradient(1, scale);
    const size_t size = gradient.values.size();
    std::vector<float> weights(size);
    AdamState state = FreshState(size);
    const std::vector<ShardGradient> shards = {gradient.pieces};
    const double norm = AdamStep(config, shards, absl::MakeSpan(weights), &state, &workers);
    const double clip = norm > 0.5 ? 0.5 / norm : 1;
    for (size_t i = 0; i < size; i += 777) {
      EXPECT_NEAR(state.exp_avg[i], 0.1 * gradient.values[i] * clip, 1e-4 * std::abs(state.exp_avg[i]) + 1e-12);
    }
  }
}

TEST(DeviceAdam, StepsAsTheCpus) {
  SetUpTorchThread();
  constexpr int kWeights = 70000;
  WorkerPool workers(1, [] {});
  const v1::PpoConfig config = AdamConfig(100);  // clips the gradients of odd steps
  for (const char* device : {"cpu:0", kStandInDevice}) {
    std::vector<float> expected(kWeights, 1);
    AdamState state = {7, std::vector<float>(kWeights, 0.1F), std::vector<float>(kWeights, 0.5F)};
    DeviceAdam adam(config);
    adam.Load(state, at::Device(device));
    const at::Tensor weights = at::ones({kWeights}).to(at::Device(device));
    for (int step = 0; step < 6; ++step) {
      std::vector<float> gradient = GoldenUniforms(absl::StrCat("gradient", step), kWeights, -0.2, 0.6);
      if (step % 2 == 1)
        std::transform(gradient.begin(), gradient.end(), gradient.begin(), [](float g) { return 9 * g; });
      const at::Tensor norm = adam.Step(SendFloats(gradient, at::Device(device)), weights);
      const std::vector<ShardGradient> shards = {{absl::MakeSpan(gradient)}};
      const double expected_norm = AdamStep(config, shards, absl::MakeSpan(expected), &state, &workers);
      EXPECT_EQ(expected_norm > config.max_gradient_norm(), step % 2 == 1);
      EXPECT_NEAR(norm.cpu().item<double>(), expected_norm, 1e-5 * expected_norm);
    }
    EXPECT_EQ(adam.steps(), state.steps);
    const auto close = [](const at::Tensor& actual, const std::vector<float>& wanted) {
      return at::allclose(actual.cpu(), at::tensor(wanted), 1e-5, 1e-7);
    };
    EXPECT_TRUE(close(adam.exp_avg(), state.exp_avg)) << device;
    EXPECT_TRUE(close(adam.exp_avg_sq(), state.exp_avg_sq)) << device;
    EXPECT_TRUE(close(weights - 1,
                      [&] {
                        std::vector<float> way = expected;
                        for (float& weight : way) weight -= 1;
                        return way;
                      }()))
        << device;
  }
}

// A GPU would write and read a copy in double of all numbers.
TEST(DeviceAdam, TakesTheNormWithoutACopyInDouble) {
  SetUpTorchThread();
  constexpr int64_t kWeights = 200000;
  const std::vector<float> zeros(kWeights);
  const at::Device device(kStandInDevice);
  DeviceAdam adam(AdamConfig(0.5));
  adam.Load({0, zeros, zeros}, device);
  int64_t norms = 0;
  ObserveComputations(
      [&](absl::string_view name, const std::vector<c10::IValue>& arguments, const std::vector<at::Tensor>& results) {
        if (name == "aten::linalg_vector_norm") {
          ++norms;
          EXPECT_EQ(arguments[0].toTensor().scalar_type(), results[0].scalar_type());
        }
        for (const at::Tensor& result : results)
          EXPECT_LT(result.scalar_type() == at::kDouble ? result.numel() : 0, 10);
      });
  adam.Step(SendFloats(zeros, device), SendFloats(zeros, device));
  ObserveComputations(nullptr);
  EXPECT_GT(norms, 0);
}

}  // namespace
}  // namespace craftfleet
