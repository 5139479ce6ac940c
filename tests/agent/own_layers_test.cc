// The layers with kernels of their own (convolutions by FFT and as one product, linear layers with a large weight):
// beside LibTorch's in float64, with autograd; bits.

#include <functional>
#include <limits>
#include <ostream>
#include <string>
#include <vector>

#include <ATen/ATen.h>
#include <ATen/CPUGeneratorImpl.h>
#include <c10/core/GradMode.h>
#include <gtest/gtest.h>
#include <torch/csrc/autograd/autograd.h>

#include "common/agent/nets/direct_conv.h"
#include "common/agent/nets/direct_convolution/direct_convolution.h"
#include "common/agent/nets/fft_conv.h"
#include "common/agent/nets/fft_convolution/fft_convolution.h"
#include "common/agent/nets/product_kernels.h"
#include "common/agent/nets/wide_linear.h"
#include "common/agent/nets/wide_product.h"
#include "common/agent/torch_setup.h"
#include "common/base/cpu_path.h"

namespace craftfleet {
namespace {

constexpr double kMaxError = 6e-7;  // of float32 against float64, in the L2 norm

// The instruction sets that have kernels of their own, and this CPU.
std::vector<CpuPath> KernelPaths() {
  std::vector<CpuPath> paths;
  for (const CpuPath path : {CpuPath::kAvx2, CpuPath::kAvx512}) {
    if (CpuHas(path)) paths.push_back(path);
  }
  return paths;
}

// Numbers in [-scale / 2, scale / 2) that depend on `stream`.
at::Tensor Numbers(at::IntArrayRef shape, uint64_t stream, double scale) {
  return at::rand(shape, at::make_generator<at::CPUGeneratorImpl>(stream)).sub_(0.5).mul_(scale);
}

// `want` is float64.
double RelativeError(const at::Tensor& want, const at::Tensor& got) {
  return ((want - got.to(at::kDouble)).norm() / want.norm()).item<double>();
}

using Compute = std::function<at::Tensor(const at::Tensor& input, const at::Tensor& weight, const at::Tensor& bias)>;

struct Case {
  std::string name;
  std::vector<int64_t> input;  // of which the first counts rows
  std::vector<int64_t> weight;
  double scale;  // of the weight
  bool has_relu;
  bool wants_input_gradient;
  Compute compute;
  Compute exact;                        // by LibTorch, without the ReLU
  at::ScalarType factors = at::kFloat;  // what the numbers of input, weight and output's gradient are rounded to
  friend void PrintTo(const Case& c, std::ostream* out) { *out << c.name; }
};

Case FftCase(int64_t size, int64_t n) {
  const Compute compute = [size](const at::Tensor& input, const at::Tensor& weight, const at::Tensor& bias) {
    const PreparedWeight filters = AllocateFftFilters(size, /*for_gradients=*/true);
    FillFftFilters(size, weight.detach(), filters);
    return FftConvRelu(input, weight, bias, filters);
  };
  const Compute exact = [](const at::Tensor& input, const at::Tensor& weight, const at::Tensor& bias) {
    return at::conv2d(input, weight, bias, /*stride=*/1, /*padding=*/2);
  };
  return {"Fft" + std::to_string(size), {n, 64, size, size}, {64, 64, 5, 5}, 0.2, true, true, compute, exact};
}

Case DirectCase(const DirectShape& shape, int64_t n, Activation activation, bool wants_input_gradient) {
  const Compute compute = [=](const at::Tensor& input, const at::Tensor& weight, const at::Tensor& bias) {
    const PreparedWeight panels = AllocateDirectPanels(shape, wants_input_gradient);
    FillDirectPanels(shape, weight.detach(), panels);
    return DirectConv(shape, input, weight, bias, activation, panels);
  };
  const Compute exact = [shape](const at::Tensor& input, const at::Tensor& weight, const at::Tensor& bias) {
    return at::conv2d(input, weight, bias, int64_t{shape.stride}, int64_t{shape.padding});
  };
  return {"Direct" + std::to_string(shape.kernel) + "on" + std::to_string(shape.size),
          {n, shape.channels, shape.size, shape.size},
          {shape.outputs, shape.channels, shape.kernel, shape.kernel},
          0.2,
          activation == Activation::kRelu,
          wants_input_gradient,
          compute,
          exact};
}

constexpr int64_t kWideInputs = 262144 + ProductKernels::kColumns;  // not a multiple of what Forward takes at once
constexpr int64_t kWideOutputs = 66;                                // nor of a block

// `leaving`: gets the factors of the weight's gradient.
Case WideCase(int64_t rows, at::ScalarType type = at::kFloat, const c10::intrusive_ptr<WideFactors>& leaving = {}) {
  const Compute compute = [=](const at::Tensor& input, const at::Tensor& weight, const at::Tensor& bias) {
    return WideLinear(input, weight, weight.detach().to(type), bias, leaving);
  };
  const Compute exact = [](const at::Tensor& input, const at::Tensor& weight, const at::Tensor& bias) {
    return at::linear(input, weight, bias);
  };
  return {(type == at::kFloat ? "Wide" : "WideBf16on") + std::to_string(rows),
          {rows, kWideInputs},
          {kWideOutputs, kWideInputs},
          0.002,
          false,
          true,
          compute,
          exact,
          type};
}

// The instruction sets that have kernels for a case, and this CPU.
std::vector<CpuPath> KernelPaths(const Case& c) {
  if (c.factors == at::kFloat) return KernelPaths();
  return FindBf16Kernels() != nullptr ? std::vector<CpuPath>{CpuPath::kAvx512} : std::vector<CpuPath>();
}

// A layer with what it computes for the first `rows` of its rows.
struct Layer {
  Layer(const Case& c, int64_t rows)
      : input(Factor(c, c.input, 1, 1).narrow(0, 0, rows).clone()),
        weight(Factor(c, c.weight, 2, c.scale)),
        bias(Numbers({c.weight[0]}, 3, 0.2)) {
    input.set_requires_grad(c.wants_input_gradient);
    for (at::Tensor* leaf : {&weight, &bias}) leaf->set_requires_grad(true);
    output = c.compute(input, weight, bias);
    by_output = Factor(c, output.sizes(), 4, 1);
    torch::autograd::backward({output}, {by_output});
  }
  explicit Layer(const Case& c) : Layer(c, c.input[0]) {}

  static at::Tensor Factor(const Case& c, at::IntArrayRef shape, uint64_t stream, double scale) {
    return Numbers(shape, stream, scale).to(c.factors).to(at::kFloat);
  }

  at::Tensor input, weight, bias, output, by_output;
};

class OwnKernels : public testing::Test {
 protected:
  void SetUp() override {
    SetUpTorchThread();
    if (KernelPaths().empty()) GTEST_SKIP() << "a CPU without AVX2";
  }
};

class OwnLayers : public OwnKernels, public testing::WithParamInterface<Case> {
 protected:
  void SetUp() override {
    OwnKernels::SetUp();
    if (KernelPaths(GetParam()).empty()) GTEST_SKIP() << "a CPU without AVX512-BF16, or with AMX";
  }
};

TEST_P(OwnLayers, AreTheirDefinitionForAutograd) {
  for (const CpuPath path : KernelPaths(GetParam())) {
    const ScopedCpuPath scoped(path);
    SCOPED_TRACE(CpuPathName(path));
    const Layer layer(GetParam());
    std::vector<at::Tensor> leaves;
    for (const at::Tensor* leaf : {&layer.input, &layer.weight, &layer.bias}) {
      leaves.push_back(leaf->detach().to(at::kDouble).set_requires_grad(true));
    }
    at::Tensor exact = GetParam().exact(leaves[0], leaves[1], leaves[2]);
    // The layer's own mask: next to 0, either side is right.
    if (GetParam().has_relu) exact = exact * layer.output.detach().gt(0).to(at::kDouble);
    torch::autograd::backward({exact}, {layer.by_output.to(at::kDouble)});
    EXPECT_LT(RelativeError(exact.detach(), layer.output.detach()), kMaxError);
    EXPECT_LT(RelativeError(leaves[1].grad(), layer.weight.grad()), kMaxError);
    EXPECT_LT(RelativeError(leaves[2].grad(), layer.bias.grad()), kMaxError);
    if (!GetParam().wants_input_gradient) continue;
    EXPECT_LT(RelativeError(leaves[0].grad(), layer.input.grad()), kMaxError);
  }
}

TEST_P(OwnLayers, ComputeTheSameBitsWithEachInstructionSetAndWithoutAutograd) {
  const Layer wanted(GetParam());
  for (const CpuPath path : KernelPaths(GetParam())) {
    const ScopedCpuPath scoped(path);
    SCOPED_TRACE(CpuPathName(path));
    const Layer layer(GetParam());
    EXPECT_TRUE(at::equal(layer.output, wanted.output));
    EXPECT_TRUE(at::equal(layer.weight.grad(), wanted.weight.grad()));
    EXPECT_TRUE(at::equal(layer.bias.grad(), wanted.bias.grad()));
    if (GetParam().wants_input_gradient) {
      EXPECT_TRUE(at::equal(layer.input.grad(), wanted.input.grad()));
    }
    const c10::NoGradGuard no_grad;
    EXPECT_TRUE(at::equal(GetParam().compute(layer.input, layer.weight, layer.bias), wanted.output));
  }
}

TEST_P(OwnLayers, ARowDoesNotDependOnTheOthers) {
  const int64_t rows = GetParam().input[0];
  const int64_t some = rows > WideProduct<float>::kMinRows ? WideProduct<float>::kMinRows + 1 : (rows + 1) / 2;
  const Layer all(GetParam());
  const Layer first(GetParam(), some);
  EXPECT_TRUE(at::equal(first.output, all.output.narrow(0, 0, some)));
  if (GetParam().wants_input_gradient) {
    EXPECT_TRUE(at::equal(first.input.grad(), all.input.grad().narrow(0, 0, some)));
  }
}

// By FFT one, two and three tiles a side, both transforms, more maps than are transformed at once. As one product the
// first layer of an SPCNN; the patches of OC-SA and OC-CA, small; odd sizes, a row of pixels left over, one output.
INSTANTIATE_TEST_SUITE_P(Kernels, OwnLayers,
                         testing::Values(FftCase(24, 37), FftCase(32, 3), FftCase(48, 2), FftCase(64, 3),
                                         FftCase(72, 1), FftCase(96, 1),
                                         DirectCase({3, 64, 5, 1, 2, 64}, 3, Activation::kRelu, false),
                                         DirectCase({64, 256, 12, 8, 0, 28}, 5, Activation::kNone, true),
                                         DirectCase({64, 128, 16, 16, 0, 36}, 3, Activation::kNone, true),
                                         DirectCase({64, 64, 3, 1, 0, 7}, 9, Activation::kRelu, true),
                                         DirectCase({32, 64, 4, 2, 0, 11}, 2, Activation::kRelu, true),
                                         DirectCase({5, 192, 3, 2, 1, 9}, 4, Activation::kNone, false),
                                         DirectCase({64, 64, 4, 1, 0, 4}, 1, Activation::kNone, true), WideCase(40),
                                         WideCase(64), WideCase(70), WideCase(33, at::kBFloat16),
                                         WideCase(64, at::kBFloat16), WideCase(71, at::kBFloat16)),
                         [](const auto& info) { return info.param.name; });

TEST_F(OwnKernels, TakeAnyLayout) {
  const c10::NoGradGuard no_grad;
  const Case c = FftCase(32, 3);
  const at::Tensor input = Numbers(c.input, 1, 1);
  const at::Tensor weight = Numbers(c.weight, 2, c.scale);
  const at::Tensor bias = Numbers({64}, 3, 0.2);
  const at::Tensor output = c.compute(input, weight, bias);
  EXPECT_TRUE(output.is_contiguous(at::MemoryFormat::ChannelsLast));
  EXPECT_TRUE(at::equal(c.compute(input.contiguous(at::MemoryFormat::ChannelsLast), weight, bias), output));
  EXPECT_TRUE(at::equal(c.compute(input.narrow(0, 1, 2), weight, bias), output.narrow(0, 1, 2)));
}

TEST_F(OwnKernels, AGradientMayBeAskedForTwice) {
  const Case c = FftCase(32, 3);
  const Layer layer(c);
  const at::Tensor once = layer.weight.grad().clone();
  torch::autograd::backward({c.compute(layer.input, layer.weight, layer.bias)}, {layer.by_output});
  EXPECT_TRUE(at::equal(layer.weight.grad(), once + once));
}

// As in the black parts of a frame before the biases have been trained.
TEST_F(OwnKernels, KeepZeros) {
  const c10::NoGradGuard no_grad;
  const Case c = FftCase(32, 3);
  constexpr int64_t kLit = 8;  // rows of the map that are not black
  at::Tensor input = Numbers(c.input, 1, 1);
  input.narrow(2, kLit, 32 - kLit).zero_();
  const at::Tensor output = c.compute(input, Numbers(c.weight, 2, c.scale), at::zeros({64}));
  EXPECT_EQ(output.narrow(2, kLit + 2, 30 - kLit).count_nonzero().item<int64_t>(), 0);
}

// As at::relu: the check of a network's outputs must see it.
TEST_F(OwnKernels, PassNanOn) {
  const c10::NoGradGuard no_grad;
  for (const Case& c : {FftCase(32, 2), DirectCase({3, 64, 5, 1, 2, 64}, 2, Activation::kRelu, false)}) {
    const at::Tensor weight = Numbers(c.weight, 2, c.scale);
    const at::Tensor bias = Numbers({64}, 3, 0.2);
    const at::Tensor input = Numbers(c.input, 1, 1);
    at::Tensor broken = input.clone();
    broken[0][1][9][12] = std::numeric_limits<float>::quiet_NaN();
    for (const CpuPath path : KernelPaths()) {
      const ScopedCpuPath scoped(path);
      SCOPED_TRACE(c.name + " " + CpuPathName(path));
      const at::Tensor output = c.compute(broken, weight, bias);
      EXPECT_TRUE(output[0].narrow(1, 7, 5).narrow(2, 10, 5).isnan().all().item<bool>());
      EXPECT_TRUE(at::equal(output[1], c.compute(input, weight, bias)[1])) << "the other row";
    }
  }
}

TEST_F(OwnKernels, SayWhatFits) {
  EXPECT_FALSE(DirectConvolution::Fits({3, 32, 8, 4, 0, 64}, false)) << "outputs are no multiple of 64";
  EXPECT_FALSE(DirectConvolution::Fits({3, 64, 5, 1, 2, 64}, true)) << "padding";
  EXPECT_FALSE(DirectConvolution::Fits({64, 64, 5, 1, 0, 4}, false)) << "no output";
  EXPECT_TRUE(DirectConvolution::Fits({3, 64, 5, 1, 2, 64}, false));
  for (const int size : {24, 32, 64, 72, 96, 120}) EXPECT_TRUE(FftConvolution::Fits(size)) << size;
  for (const int size : {0, 16, 36, 65}) EXPECT_FALSE(FftConvolution::Fits(size)) << size;
  EXPECT_TRUE(WideLinearFits(at::empty({kWideOutputs, kWideInputs}), at::kFloat));
  EXPECT_EQ(WideLinearFits(at::empty({kWideOutputs, kWideInputs}), at::kBFloat16), FindBf16Kernels() != nullptr);
  EXPECT_FALSE(WideLinearFits(at::empty({kWideOutputs + 1, kWideInputs}), at::kBFloat16)) << "an odd number of outputs";
  const ScopedCpuPath base(CpuPath::kBase);
  EXPECT_FALSE(DirectConvolution::Fits({3, 64, 5, 1, 2, 64}, false));
  EXPECT_FALSE(FftConvolution::Fits(64));
  EXPECT_FALSE(WideLinearFits(at::empty({kWideOutputs, kWideInputs}), at::kBFloat16));
}

TEST_F(OwnKernels, LeftFactorsGiveTheSumOfTheShardsGradients) {
  for (const at::ScalarType type : {at::kFloat, at::kBFloat16}) {
    if (KernelPaths(WideCase(40, type)).empty()) continue;
    SCOPED_TRACE(c10::toString(type));
    const auto first = c10::make_intrusive<WideFactors>();
    const auto second = c10::make_intrusive<WideFactors>();
    EXPECT_FALSE(Layer(WideCase(41, type, first)).weight.grad().defined());
    EXPECT_FALSE(Layer(WideCase(70, type, second)).weight.grad().defined());
    const at::Tensor sum = at::empty({kWideOutputs, kWideInputs});
    auto* const numbers = sum.data_ptr<float>();
    constexpr int64_t kColumns = ProductKernels::kColumns;
    constexpr int64_t kHalf = kWideInputs / 2 / kColumns * kColumns;
    const std::vector<const WideFactors*> shards = {first.get(), second.get()};
    WideWeightGradient(shards, kHalf, kWideInputs, {numbers});
    WideWeightGradient(shards, 0, kHalf, {numbers, numbers + kWideOutputs / 2 * kWideInputs});
    EXPECT_TRUE(at::equal(sum, Layer(WideCase(41, type)).weight.grad() + Layer(WideCase(70, type)).weight.grad()));
  }
}

TEST_F(OwnKernels, Bfloat16RoundsEachFactor) {
  if (FindBf16Kernels() == nullptr) GTEST_SKIP() << "a CPU without AVX512-BF16, or with AMX";
  const Layer of_rounded(WideCase(40, at::kBFloat16));
  Case c = WideCase(40, at::kBFloat16);
  c.factors = at::kFloat;
  const Layer layer(c);
  EXPECT_FALSE(at::equal(layer.weight, of_rounded.weight));
  EXPECT_TRUE(at::equal(layer.output, of_rounded.output));
  EXPECT_TRUE(at::equal(layer.input.grad(), of_rounded.input.grad()));
  EXPECT_TRUE(at::equal(layer.weight.grad(), of_rounded.weight.grad()));
}

// LibTorch computes the output of so few; in bfloat16 it rounds that once more.
TEST_F(OwnKernels, FewRowsAreTheSameLayer) {
  for (const at::ScalarType type : {at::kFloat, at::kBFloat16}) {
    const Case few = WideCase(5, type);
    if (KernelPaths(few).empty()) continue;
    SCOPED_TRACE(c10::toString(type));
    const Layer layer(few);
    const Layer of_many(WideCase(40, type), 40);
    EXPECT_LT(RelativeError(of_many.output.detach().narrow(0, 0, 5).to(at::kDouble), layer.output.detach()),
              type == at::kFloat ? 5e-6 : 4e-3);
    EXPECT_TRUE(at::equal(layer.input.grad(), of_many.input.grad().narrow(0, 0, 5)));
  }
}

}  // namespace
}  // namespace craftfleet
