#include "common/agent/policy_net.h"

#include <cmath>

#include <ATen/ATen.h>
#include <gtest/gtest.h>
#include <torch/csrc/autograd/autograd.h>

#include "common/agent/categorical.h"
#include "common/agent/initial_weights.h"
#include "common/agent/linear.h"
#include "common/agent/torch_setup.h"
#include "tests/agent/golden_agent.h"

namespace craftfleet {
namespace {

using testing::GoldenFrames;
using testing::GoldenWeights;
using testing::ReadGolden;

at::Tensor AsInput(const std::string& frames, const AgentSpec& spec) {
  const int n = static_cast<int>(frames.size() / spec.frame_bytes());
  at::Tensor input = at::empty({n, spec.frame_size, spec.frame_size, 3});
  std::vector<const uint8_t*> rows(n);
  for (int i = 0; i < n; ++i) rows[i] = reinterpret_cast<const uint8_t*>(&frames[i * spec.frame_bytes()]);
  ScaleFrames(rows, spec.frame_bytes(), input.data_ptr<float>());
  return input;
}

TEST(GoldenAgent, FormulasGiveTheGoldensWeightsAndFrames) {
  const nlohmann::json golden = ReadGolden("ppo_cnn.json");
  const AgentSpec spec = *FindAgent("ppo_cnn");
  EXPECT_EQ(spec.param_count, golden["param_count"]);
  const std::vector<float> weights = GoldenWeights(spec, golden);
  for (size_t p = 0; p < spec.params.size(); ++p) {
    const nlohmann::json& param = golden["params"][p];
    EXPECT_EQ(spec.params[p].name, param["name"]);
    EXPECT_EQ(spec.params[p].shape, param["shape"].get<std::vector<int64_t>>());
    for (size_t i = 0; i < param["first3"].size(); ++i) {
      EXPECT_EQ(weights[spec.params[p].offset + i], param["first3"][i].get<float>());
    }
  }
  int64_t sum = 0;
  for (const char byte : GoldenFrames(golden["frames"]["seed"], golden["frames"]["n"], 64)) {
    sum += static_cast<unsigned char>(byte);
  }
  EXPECT_EQ(sum, golden["frames"]["byte_sum"]);
}

TEST(PolicyNet, ForwardMatchesTheGolden) {
  SetUpTorchThread();
  const nlohmann::json golden = ReadGolden("ppo_cnn.json");
  const AgentSpec spec = *FindAgent("ppo_cnn");
  std::vector<float> weights = GoldenWeights(spec, golden);
  const at::Tensor input = AsInput(GoldenFrames(golden["frames"]["seed"], golden["frames"]["n"], 64), spec);
  for (const PolicyNet::Use use : {PolicyNet::Use::kActing, PolicyNet::Use::kTraining}) {
    const PolicyNet net(spec, use, absl::MakeSpan(weights));
    const PolicyNet::Output output = net.Forward(input);
    const nlohmann::json& forward = golden["forward"];
    for (int row = 0; row < 4; ++row) {
      // 1e-5: the golden comes from other convolution code.
      EXPECT_NEAR(output.values[row].item<float>(), forward["values"][row].get<double>(), 1e-5);
      const Categorical odds(output.logits.data_ptr<float>() + row * kNumActions);
      EXPECT_EQ(static_cast<int>(odds.Greedy()), forward["greedy_actions"][row].get<int>());
      EXPECT_NEAR(odds.Entropy(), forward["entropy"][row].get<double>(), 1e-5);
      for (int i = 0; i < kNumActions; ++i) {
        EXPECT_NEAR(output.logits[row][i].item<float>(), forward["logits_raw"][row][i].get<double>(), 1e-5);
        EXPECT_NEAR(odds.log_probs[i], forward["log_softmax"][row][i].get<double>(), 1e-5);
      }
    }
  }
}

TEST(PolicyNet, FirstPolicyIsNearlyUniform) {
  SetUpTorchThread();
  const AgentSpec spec = *FindAgent("ppo_cnn");
  std::vector<float> weights = InitialWeights(spec, 1);
  const PolicyNet net(spec, PolicyNet::Use::kActing, absl::MakeSpan(weights));
  const PolicyNet::Output output = net.Forward(AsInput(GoldenFrames(5, 32, 64), spec));
  for (int row = 0; row < 32; ++row) {
    const Categorical odds(output.logits.data_ptr<float>() + row * kNumActions);
    EXPECT_GT(odds.Entropy(), 2.833);  // ln 17 = 2.83321
  }
}

TEST(Linear, ValueAndGradientsAreThoseOfTheMatrixProduct) {
  SetUpTorchThread();
  at::manual_seed(3);
  const auto leaf = [](at::IntArrayRef shape) { return at::randn(shape).set_requires_grad(true); };
  const at::Tensor weight = leaf({3, 7});
  const at::Tensor bias = leaf({3});
  for (const int rows : {1, 5}) {
    const at::Tensor input = leaf({rows, 7});
    const at::Tensor by_output = at::randn({rows, 3});
    const at::Tensor expected = at::linear(input, weight, bias);
    const at::Tensor output = Linear(input, weight, bias);
    EXPECT_TRUE(at::allclose(output, expected, 1e-5, 1e-6));
    const auto gradients = torch::autograd::grad({output}, {input, weight, bias}, {by_output});
    const auto expected_gradients = torch::autograd::grad({expected}, {input, weight, bias}, {by_output});
    for (size_t i = 0; i < gradients.size(); ++i) {
      EXPECT_TRUE(at::allclose(gradients[i], expected_gradients[i], 1e-5, 1e-6)) << i;
    }
  }
}

TEST(ScaleFrames, GivesEachByteAsFractionOf255) {
  const std::vector<uint8_t> frame = {0, 1, 128, 255};
  std::vector<float> out(8);
  ScaleFrames({frame.data(), frame.data()}, 4, out.data());
  for (int i = 0; i < 8; ++i) EXPECT_FLOAT_EQ(out[i], frame[i % 4] / 255.0F);
}

TEST(TorchSetup, DescribesTheCpuAndIsSilentWhereMathIsFast) {
  EXPECT_NE(CpuDescription().find(", "), std::string::npos) << CpuDescription();
  EXPECT_TRUE(!LinearUsesOneDnn() || SlowMathWarning().empty());
}

}  // namespace
}  // namespace craftfleet
