#include "common/agent/nets/lstm.h"

#include <numeric>
#include <string>
#include <vector>

#include <ATen/ATen.h>
#include <gtest/gtest.h>
#include <torch/csrc/autograd/autograd.h>

#include "tests/agent/golden_agent.h"
#include "tests/agent/stand_in_device.h"

namespace craftfleet {
namespace {

constexpr int64_t kInputs = 24;
constexpr int64_t kHidden = 20;  // not a multiple of a vector's length

at::Tensor Uniform(const std::string& tag, at::IntArrayRef shape) {
  std::vector<float> values = GoldenUniforms(tag, c10::multiply_integers(shape), -0.5, 0.5);
  return at::from_blob(values.data(), shape).clone();
}

void ExpectNear(const at::Tensor& actual, const at::Tensor& wanted, const char* what) {
  ASSERT_EQ(actual.sizes(), wanted.sizes()) << what;
  EXPECT_LT((actual - wanted).abs().max().item<float>(), 2e-5 * (1 + wanted.abs().max().item<float>())) << what;
}

class LstmTest : public testing::TestWithParam<std::vector<int64_t>> {};

// The same by LibTorch.
LstmOutput LstmOfLibTorch(const at::Tensor& input, const std::vector<int64_t>& batch_sizes, const at::Tensor& states,
                          const LstmWeights& weights) {
  const at::Tensor layer_states = states.unsqueeze(0);
  const auto [outputs, h, c] =
      at::lstm(input, at::tensor(batch_sizes, at::kLong),
               {layer_states.narrow(2, 0, kHidden).contiguous(), layer_states.narrow(2, kHidden, kHidden).contiguous()},
               {weights.input, weights.hidden, weights.input_bias, weights.hidden_bias}, /*has_biases=*/true,
               /*num_layers=*/1, /*dropout=*/0, /*train=*/true, /*bidirectional=*/false);
  return {outputs, at::cat({h, c}, 2).squeeze(0).detach()};
}

// The two outputs and the gradients of the input and the weights.
template <typename Function>
std::vector<at::Tensor> ResultsOf(const Function& lstm, const std::vector<int64_t>& batch_sizes,
                                  const at::Device& device) {
  const int64_t n = std::accumulate(batch_sizes.begin(), batch_sizes.end(), int64_t{0});
  const auto leaf = [&](const std::string& tag, at::IntArrayRef shape) {
    return Uniform(tag, shape).to(device).set_requires_grad(true);
  };
  const at::Tensor input = leaf("input", {n, kInputs});
  const LstmWeights weights = {leaf("wi", {4 * kHidden, kInputs}), leaf("wh", {4 * kHidden, kHidden}),
                               leaf("bi", {4 * kHidden}), leaf("bh", {4 * kHidden})};
  const at::Tensor states = Uniform("states", {batch_sizes.front(), 2 * kHidden}).to(device);
  const LstmOutput output = lstm(input, batch_sizes, states, weights);
  EXPECT_FALSE(output.last_states.requires_grad());
  torch::autograd::backward({output.outputs}, {Uniform("gradient", {n, kHidden}).to(device)});
  EXPECT_NE(weights.input_bias.grad().data_ptr(), weights.hidden_bias.grad().data_ptr()) << "each is clipped in place";
  std::vector<at::Tensor> results = {output.outputs.detach(), output.last_states, input.grad()};
  for (const auto* weight : {&weights.input, &weights.hidden, &weights.input_bias, &weights.hidden_bias}) {
    results.push_back(weight->grad());
  }
  for (at::Tensor& result : results) result = result.cpu();
  return results;
}

TEST_P(LstmTest, OutputsStatesAndGradientsMatchLibTorch) {
  constexpr const char* kNames[] = {"outputs",       "last states", "input",      "input weight",
                                    "hidden weight", "input bias",  "hidden bias"};
  const std::vector<at::Tensor> wanted = ResultsOf(LstmOfLibTorch, GetParam(), at::kCPU);
  for (const char* device : {"cpu", kStandInDevice}) {
    SCOPED_TRACE(device);
    const std::vector<at::Tensor> actual = ResultsOf(Lstm, GetParam(), at::Device(device));
    for (size_t i = 0; i < wanted.size(); ++i) ExpectNear(actual[i], wanted[i], kNames[i]);
  }
}

INSTANTIATE_TEST_SUITE_P(Lengths, LstmTest,
                         testing::Values(std::vector<int64_t>{1}, std::vector<int64_t>{5},
                                         std::vector<int64_t>{1, 1, 1}, std::vector<int64_t>{4, 4, 4},
                                         std::vector<int64_t>{5, 3, 3, 2, 1, 1}));

}  // namespace
}  // namespace craftfleet
