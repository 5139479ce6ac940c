#include "common/agent/policy_net.h"

#include <cmath>
#include <fstream>
#include <iterator>
#include <string>
#include <vector>

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

TEST(PolicyNet, InitialPolicyIsNearlyUniform) {
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

TEST(Linear, ValueAndGradientsMatchTheMatrixProduct) {
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

TEST(ScaleFrames, ScalesBytesToZeroToOne) {
  const std::vector<uint8_t> frame = {0, 1, 128, 255};
  std::vector<float> out(8);
  ScaleFrames({frame.data(), frame.data()}, 4, out.data());
  for (int i = 0; i < 8; ++i) EXPECT_FLOAT_EQ(out[i], frame[i % 4] / 255.0F);
}

TEST(TorchSetup, DescribesTheCpuAndWarnsOnlyIfMathIsSlow) {
  EXPECT_NE(CpuDescription().find(", "), std::string::npos) << CpuDescription();
  EXPECT_TRUE(!LinearUsesOneDnn() || SlowMathWarning().empty());
}

TEST(TorchSetup, LinearLayersUseOneDnnWhereItIsALibraryOfItsOwn) {
  std::ifstream file("/proc/self/maps");
  const std::string maps((std::istreambuf_iterator<char>(file)), std::istreambuf_iterator<char>());
  EXPECT_EQ(LinearUsesOneDnn(), maps.find("/libdnnl.so") != std::string::npos);
}

}  // namespace
}  // namespace craftfleet
