#include "common/agent/nets/lstm.h"

#include <array>
#include <numeric>

#include <ATen/ATen.h>
#include <gtest/gtest.h>
#include <torch/csrc/autograd/autograd.h>

#include "tests/agent/golden_agent.h"

namespace craftfleet {
namespace {

constexpr int64_t kInputs = 24;
constexpr int64_t kHidden = 20;  // not a multiple of a vector's length

at::Tensor Uniform(const std::string& tag, at::IntArrayRef shape) {
  std::vector<float> values = testing::GoldenUniforms(tag, c10::multiply_integers(shape), -0.5, 0.5);
  return at::from_blob(values.data(), shape).clone();
}

LstmWeights Weights() {
  LstmWeights weights = {Uniform("wi", {4 * kHidden, kInputs}), Uniform("wh", {4 * kHidden, kHidden}),
                         Uniform("bi", {4 * kHidden}), Uniform("bh", {4 * kHidden})};
  for (at::Tensor* weight : {&weights.input, &weights.hidden, &weights.input_bias, &weights.hidden_bias}) {
    weight->set_requires_grad(true);
  }
  return weights;
}

void ExpectNear(const at::Tensor& actual, const at::Tensor& wanted, const char* what) {
  ASSERT_EQ(actual.sizes(), wanted.sizes()) << what;
  EXPECT_LT((actual - wanted).abs().max().item<float>(), 2e-5 * (1 + wanted.abs().max().item<float>())) << what;
}

class LstmTest : public ::testing::TestWithParam<std::vector<int64_t>> {};

TEST_P(LstmTest, OutputsStatesAndGradientsMatchLibTorch) {
  const std::vector<int64_t>& batch_sizes = GetParam();
  const int64_t n = std::accumulate(batch_sizes.begin(), batch_sizes.end(), int64_t{0});
  const int64_t k = batch_sizes.front();
  const at::Tensor states = Uniform("states", {k, 2 * kHidden});
  const at::Tensor by_outputs = Uniform("gradient", {n, kHidden});

  const LstmWeights ours = Weights();
  const at::Tensor our_input = Uniform("input", {n, kInputs}).set_requires_grad(true);
  const LstmOutput output = Lstm(our_input, batch_sizes, states, ours);
  EXPECT_FALSE(output.last_states.requires_grad());
  torch::autograd::backward({output.outputs}, {by_outputs});

  const LstmWeights theirs = Weights();
  const at::Tensor their_input = Uniform("input", {n, kInputs}).set_requires_grad(true);
  const LstmOutput wanted = LstmOfLibTorch(their_input, batch_sizes, states, theirs);
  EXPECT_FALSE(wanted.last_states.requires_grad());
  torch::autograd::backward({wanted.outputs}, {by_outputs});

  ExpectNear(output.outputs, wanted.outputs, "outputs");
  ExpectNear(output.last_states, wanted.last_states, "last states");
  ExpectNear(our_input.grad(), their_input.grad(), "input");
  ExpectNear(ours.input.grad(), theirs.input.grad(), "input weight");
  ExpectNear(ours.hidden.grad(), theirs.hidden.grad(), "hidden weight");
  ExpectNear(ours.input_bias.grad(), theirs.input_bias.grad(), "input bias");
  ExpectNear(ours.hidden_bias.grad(), theirs.hidden_bias.grad(), "hidden bias");
  EXPECT_NE(ours.input_bias.grad().data_ptr(), ours.hidden_bias.grad().data_ptr()) << "each is clipped in place";
}

INSTANTIATE_TEST_SUITE_P(Lengths, LstmTest,
                         ::testing::Values(std::vector<int64_t>{1}, std::vector<int64_t>{5},
                                           std::vector<int64_t>{1, 1, 1}, std::vector<int64_t>{4, 4, 4},
                                           std::vector<int64_t>{5, 3, 3, 2, 1, 1}));

}  // namespace
}  // namespace craftfleet
