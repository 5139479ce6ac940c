// The convolution by FFT on tensors: beside LibTorch's own, with autograd.

#include "common/agent/nets/fft_conv.h"

#include <vector>

#include <ATen/ATen.h>
#include <c10/core/GradMode.h>
#include <gtest/gtest.h>
#include <torch/csrc/autograd/autograd.h>

#include "common/agent/nets/fft_convolution/fft_convolution.h"
#include "common/agent/torch_setup.h"
#include "tests/agent/kernel_numbers.h"

namespace craftfleet {
namespace {

using testing::kMaxError;
using testing::Numbers;
using testing::RelativeError;

class FftConvTest : public ::testing::Test {
 protected:
  static constexpr int64_t kSize = 24;

  void SetUp() override {
    SetUpTorchThread();
    if (!FftConvolution::Fits(kSize)) GTEST_SKIP() << "a CPU without AVX2";
    for (at::Tensor* leaf : {&input_, &weight_, &bias_}) leaf->set_requires_grad(true);
    filters_ = AllocateFftFilters(kSize, /*for_gradients=*/true);
    const c10::NoGradGuard no_grad;
    FillFftFilters(kSize, weight_, filters_);
  }

  at::Tensor Compute() const { return FftConvRelu(input_, weight_, bias_, filters_); }

  at::Tensor input_ = Numbers({3, 64, kSize, kSize}, 1, 1);
  at::Tensor weight_ = Numbers({64, 64, 5, 5}, 2, 0.2);
  at::Tensor bias_ = Numbers({64}, 3, 0.2);
  PreparedWeight filters_;
};

TEST_F(FftConvTest, IsAConvolutionWithReluForAutograd) {
  const at::Tensor output = Compute();
  EXPECT_TRUE(output.is_contiguous(at::MemoryFormat::ChannelsLast));
  const at::Tensor by_output = Numbers(output.sizes(), 4, 1);
  torch::autograd::backward({output}, {by_output});

  std::vector<at::Tensor> leaves;
  for (const at::Tensor* leaf : {&input_, &weight_, &bias_}) {
    leaves.push_back(leaf->detach().to(at::kDouble).set_requires_grad(true));
  }
  // The layer's own mask: next to 0, either side is right.
  const at::Tensor exact =
      at::conv2d(leaves[0], leaves[1], leaves[2], /*stride=*/1, /*padding=*/2) * output.detach().gt(0).to(at::kDouble);
  torch::autograd::backward({exact}, {by_output.to(at::kDouble)});
  EXPECT_LT(RelativeError(exact.detach(), output.detach()), kMaxError);
  EXPECT_LT(RelativeError(leaves[0].grad(), input_.grad()), kMaxError);
  EXPECT_LT(RelativeError(leaves[1].grad(), weight_.grad()), kMaxError);
  EXPECT_LT(RelativeError(leaves[2].grad(), bias_.grad()), kMaxError);
}

TEST_F(FftConvTest, GradientsAreFiniteDifferences) {
  // Far from 0, so that a step does not cross the ReLU.
  const c10::NoGradGuard no_grad;
  bias_.fill_(20);
  const at::Tensor by_output = Numbers({3, 64, kSize, kSize}, 4, 1);
  {
    const at::AutoGradMode recording(true);
    torch::autograd::backward({Compute()}, {by_output});
  }
  const auto value = [&] {
    FillFftFilters(kSize, weight_, filters_);
    return (Compute().to(at::kDouble) * by_output.to(at::kDouble)).sum().item<double>();
  };
  for (at::Tensor* leaf : {&input_, &weight_, &bias_}) {
    const at::Tensor direction = Numbers(leaf->sizes(), 5, 0.02);
    const at::Tensor start = leaf->clone();
    leaf->copy_(start + direction);
    const double after = value();
    leaf->copy_(start - direction);
    const double before = value();
    leaf->copy_(start);
    const double slope = (leaf->grad().to(at::kDouble) * direction.to(at::kDouble)).sum().item<double>();
    EXPECT_NEAR((after - before) / 2, slope, 1e-3 * std::abs(slope)) << leaf->sizes();
  }
}

TEST_F(FftConvTest, ComputesTheSameBitsWithoutAutograd) {
  const at::Tensor recorded = Compute().detach();
  const c10::NoGradGuard no_grad;
  EXPECT_TRUE(at::equal(Compute(), recorded));
}

TEST_F(FftConvTest, TakesAnyLayout) {
  const c10::NoGradGuard no_grad;
  const at::Tensor output = Compute();
  EXPECT_TRUE(
      at::equal(FftConvRelu(input_.contiguous(at::MemoryFormat::ChannelsLast), weight_, bias_, filters_), output));
  const at::Tensor two = input_.narrow(0, 1, 2);
  EXPECT_TRUE(at::equal(FftConvRelu(two, weight_, bias_, filters_), output.narrow(0, 1, 2)));
}

TEST_F(FftConvTest, AGradientMayBeAskedForTwice) {
  const at::Tensor by_output = at::ones({3, 64, kSize, kSize});
  torch::autograd::backward({Compute()}, {by_output});
  const at::Tensor once = weight_.grad().clone();
  torch::autograd::backward({Compute()}, {by_output});
  EXPECT_TRUE(at::equal(weight_.grad(), once + once));
}

}  // namespace
}  // namespace craftfleet
