// The linear layer with a large weight: beside LibTorch's product in float64, with autograd; bits.

#include "common/agent/nets/wide_linear.h"

#include <cstdint>
#include <vector>

#include <ATen/ATen.h>
#include <gtest/gtest.h>
#include <torch/csrc/autograd/autograd.h>

#include "common/agent/nets/wide_product.h"
#include "common/agent/torch_setup.h"
#include "common/base/cpu_path.h"
#include "tests/agent/kernel_numbers.h"

namespace craftfleet {
namespace {

using testing::KernelPaths;
using testing::kMaxError;
using testing::Numbers;
using testing::RelativeError;

constexpr int64_t kInputs = 262144 + WideProduct::kColumns;  // not a multiple of what Forward takes at once
constexpr int64_t kOutputs = 66;                             // nor of a block

// A layer with what it computes for the first `rows` of 70 rows.
struct Layer {
  explicit Layer(int64_t rows, const c10::intrusive_ptr<WideFactors>& factors = {})
      : input(Numbers({70, kInputs}, 1, 1).narrow(0, 0, rows).clone()), weight(Numbers({kOutputs, kInputs}, 2, 0.002)) {
    for (at::Tensor* leaf : {&input, &weight, &bias}) leaf->set_requires_grad(true);
    output = WideLinear(input, weight, bias, factors);
    torch::autograd::backward({output}, {by_output.narrow(0, 0, rows)});
  }

  at::Tensor input, weight, output;
  at::Tensor bias = Numbers({kOutputs}, 3, 0.2);
  at::Tensor by_output = Numbers({70, kOutputs}, 4, 1);
};

class WideLinearTest : public ::testing::Test {
 protected:
  void SetUp() override {
    SetUpTorchThread();
    if (KernelPaths().empty()) GTEST_SKIP() << "a CPU without AVX2";
  }
};

TEST_F(WideLinearTest, IsALinearLayerForAutograd) {
  for (const int64_t rows : {40, 64, 70}) {
    const Layer layer(rows);
    ASSERT_TRUE(WideLinearFits(layer.weight));
    std::vector<at::Tensor> leaves;
    for (const at::Tensor* leaf : {&layer.input, &layer.weight, &layer.bias}) {
      leaves.push_back(leaf->detach().to(at::kDouble).set_requires_grad(true));
    }
    const at::Tensor exact = at::linear(leaves[0], leaves[1], leaves[2]);
    torch::autograd::backward({exact}, {layer.by_output.narrow(0, 0, rows).to(at::kDouble)});
    EXPECT_LT(RelativeError(exact.detach(), layer.output.detach()), kMaxError) << rows;
    EXPECT_LT(RelativeError(leaves[0].grad(), layer.input.grad()), kMaxError) << rows;
    EXPECT_LT(RelativeError(leaves[1].grad(), layer.weight.grad()), kMaxError) << rows;
    EXPECT_LT(RelativeError(leaves[2].grad(), layer.bias.grad()), kMaxError) << rows;
  }
}

TEST_F(WideLinearTest, ARowDependsNeitherOnTheOthersNorOnTheInstructionSet) {
  const Layer all(70);
  for (const CpuPath path : KernelPaths()) {
    const ScopedCpuPath scoped(path);
    const Layer some(40);
    EXPECT_TRUE(at::equal(some.output, all.output.narrow(0, 0, 40))) << CpuPathName(path);
    EXPECT_TRUE(at::equal(some.input.grad(), all.input.grad().narrow(0, 0, 40))) << CpuPathName(path);
  }
}

TEST_F(WideLinearTest, LeftFactorsGiveTheSumOfTheShardsGradients) {
  const auto factors = c10::make_intrusive<WideFactors>();
  const Layer left(40, factors);
  EXPECT_FALSE(left.weight.grad().defined());
  const Layer first(40);
  const Layer second(70);
  const at::Tensor sum = at::empty({kOutputs, kInputs});
  auto* const numbers = sum.data_ptr<float>();
  const std::vector<WideProduct::Rows> rows = {
      {40, factors->output_gradient.data_ptr<float>(), factors->input.data_ptr<float>()},
      {70, second.by_output.data_ptr<float>(), second.input.data_ptr<float>()}};
  const WideProduct product(kInputs, kOutputs);
  constexpr int64_t kHalf = kInputs / 2 / WideProduct::kColumns * WideProduct::kColumns;
  product.WeightGradient(rows, kHalf, kInputs, {numbers});
  product.WeightGradient(rows, 0, kHalf, {numbers, numbers + kOutputs / 2 * kInputs});
  EXPECT_TRUE(at::equal(sum, first.weight.grad() + second.weight.grad()));
}

}  // namespace
}  // namespace craftfleet
