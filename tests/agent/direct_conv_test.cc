// The convolution as one product: beside LibTorch's own in float64, with autograd; bits.

#include "common/agent/nets/direct_conv.h"

#include <cstdint>
#include <cstring>
#include <utility>
#include <vector>

#include <ATen/ATen.h>
#include <c10/core/GradMode.h>
#include <gtest/gtest.h>
#include <torch/csrc/autograd/autograd.h>

#include "common/agent/nets/direct_convolution/direct_convolution.h"
#include "common/agent/torch_setup.h"
#include "common/base/cpu_path.h"
#include "tests/agent/kernel_numbers.h"

namespace craftfleet {
namespace {

using testing::KernelPaths;
using testing::kMaxError;
using testing::Numbers;
using testing::RelativeError;

struct Case {
  DirectShape shape;
  int n;
  Activation activation;
  bool wants_input_gradient;
};

// A layer with what it computes.
struct Layer {
  explicit Layer(const Case& c)
      : shape(c.shape),
        activation(c.activation),
        input(Numbers({c.n, c.shape.channels, c.shape.size, c.shape.size}, 1, 1)),
        weight(Numbers({c.shape.outputs, c.shape.channels, c.shape.kernel, c.shape.kernel}, 2, 0.2)),
        bias(Numbers({c.shape.outputs}, 3, 0.2)) {
    input.set_requires_grad(c.wants_input_gradient);
    weight.set_requires_grad(true);
    bias.set_requires_grad(true);
  }

  void Compute() {
    panels = AllocateDirectPanels(shape, input.requires_grad());
    FillDirectPanels(shape, weight, panels);
    output = DirectConv(shape, input, weight, bias, activation, panels);
    by_output = Numbers(output.sizes(), 4, 1);
    torch::autograd::backward({output}, {by_output});
  }

  std::vector<at::Tensor> results() const {
    std::vector<at::Tensor> results = {output.detach(), weight.grad(), bias.grad()};
    if (input.requires_grad()) results.push_back(input.grad());
    return results;
  }

  DirectShape shape;
  Activation activation;
  at::Tensor input, weight, bias, output, by_output;
  PreparedWeight panels;
};

class DirectConvTest : public ::testing::TestWithParam<Case> {
 protected:
  void SetUp() override {
    SetUpTorchThread();
    if (KernelPaths().empty()) GTEST_SKIP() << "a CPU without AVX2";
  }
};

TEST_P(DirectConvTest, IsAConvolutionForAutograd) {
  for (const CpuPath path : KernelPaths()) {
    const ScopedCpuPath scoped(path);
    SCOPED_TRACE(CpuPathName(path));
    ASSERT_TRUE(DirectConvolution::Fits(GetParam().shape, GetParam().wants_input_gradient));
    Layer layer(GetParam());
    layer.Compute();
    std::vector<at::Tensor> leaves;
    for (const at::Tensor* leaf : {&layer.input, &layer.weight, &layer.bias}) {
      leaves.push_back(leaf->detach().to(at::kDouble).set_requires_grad(true));
    }
    const int64_t stride = layer.shape.stride;
    const int64_t padding = layer.shape.padding;
    at::Tensor exact = at::conv2d(leaves[0], leaves[1], leaves[2], {stride, stride}, {padding, padding});
    // The layer's own mask: next to 0, either side is right.
    if (layer.activation == Activation::kRelu) exact = exact * layer.output.detach().gt(0).to(at::kDouble);
    torch::autograd::backward({exact}, {layer.by_output.to(at::kDouble)});
    EXPECT_LT(RelativeError(exact.detach(), layer.output.detach()), kMaxError);
    EXPECT_LT(RelativeError(leaves[1].grad(), layer.weight.grad()), kMaxError);
    EXPECT_LT(RelativeError(leaves[2].grad(), layer.bias.grad()), kMaxError);
    if (GetParam().wants_input_gradient) {
      EXPECT_LT(RelativeError(leaves[0].grad(), layer.input.grad()), kMaxError);
    }
  }
}

TEST_P(DirectConvTest, BothInstructionSetsComputeTheSameBits) {
  if (KernelPaths().size() < 2) GTEST_SKIP() << "a CPU without AVX-512";
  std::vector<std::vector<at::Tensor>> results;
  for (const CpuPath path : KernelPaths()) {
    const ScopedCpuPath scoped(path);
    Layer layer(GetParam());
    layer.Compute();
    results.push_back(layer.results());
  }
  for (size_t i = 0; i < results[0].size(); ++i) EXPECT_TRUE(at::equal(results[0][i], results[1][i])) << i;
}

TEST_P(DirectConvTest, AMapDoesNotDependOnTheOthersNorOnAutograd) {
  Layer layer(GetParam());
  layer.Compute();
  const c10::NoGradGuard no_grad;
  for (int64_t i = 0; i < layer.input.size(0); ++i) {
    const at::Tensor one =
        DirectConv(layer.shape, layer.input.narrow(0, i, 1), layer.weight, layer.bias, layer.activation, layer.panels);
    EXPECT_TRUE(at::equal(one, layer.output.narrow(0, i, 1))) << i;
  }
}

// The first layer of an SPCNN; the patches of OC-SA and OC-CA, small; odd sizes, a row of pixels left over, one output.
INSTANTIATE_TEST_SUITE_P(Shapes, DirectConvTest,
                         ::testing::Values(Case{{3, 64, 5, 1, 2, 64}, 3, Activation::kRelu, false},
                                           Case{{64, 256, 12, 8, 0, 28}, 5, Activation::kNone, true},
                                           Case{{64, 128, 16, 16, 0, 36}, 3, Activation::kNone, true},
                                           Case{{64, 64, 3, 1, 0, 7}, 9, Activation::kRelu, true},
                                           Case{{32, 64, 4, 2, 0, 11}, 2, Activation::kRelu, true},
                                           Case{{5, 192, 3, 2, 1, 9}, 4, Activation::kNone, false},
                                           Case{{64, 64, 4, 1, 0, 4}, 1, Activation::kNone, true}));

TEST(DirectConv, SaysWhatFits) {
  if (KernelPaths().empty()) GTEST_SKIP() << "a CPU without AVX2";
  EXPECT_FALSE(DirectConvolution::Fits({3, 32, 8, 4, 0, 64}, false)) << "outputs are no multiple of 64";
  EXPECT_FALSE(DirectConvolution::Fits({3, 64, 5, 1, 2, 64}, true)) << "padding";
  EXPECT_FALSE(DirectConvolution::Fits({64, 64, 5, 1, 0, 4}, false)) << "no output";
  const ScopedCpuPath base(CpuPath::kBase);
  EXPECT_FALSE(DirectConvolution::Fits({3, 64, 5, 1, 2, 64}, false));
}

}  // namespace
}  // namespace craftfleet
