#include "common/agent/nets/layers.h"

#include <algorithm>
#include <vector>

#include <ATen/ATen.h>
#include <c10/core/GradMode.h>

#include "common/agent/linear.h"
#include "common/agent/nets/attention.h"
#include "common/agent/nets/direct_conv.h"
#include "common/agent/nets/fft_conv.h"
#include "common/agent/nets/fft_convolution/fft_convolution.h"
#include "common/agent/nets/map_tensors.h"
#include "common/agent/nets/param_tensors.h"
#include "common/agent/nets/prepared_weights.h"
#include "common/agent/nets/wide_linear.h"

namespace craftfleet {
namespace {

constexpr double kNormEpsilon = 1e-5;

ParamIndex AddBias(const std::string& name, int64_t outputs, Bias bias, ParamInit weight_init, ParamList* params) {
  if (bias == Bias::kNone) return kNoParam;
  return params->Add(name + ".bias", {outputs}, bias == Bias::kLikeWeight ? weight_init : ParamInit());
}

// An undefined tensor where there is none.
at::Tensor BiasOf(const ParamTensors& params, ParamIndex bias) {
  return bias == kNoParam ? at::Tensor() : params[bias];
}

// Linear (common/agent/linear.h), multiplied as `weight` is: float[N,out].
at::Tensor LinearAs(const at::Tensor& input, const at::Tensor& weight, const at::Tensor& bias) {
  if (weight.scalar_type() == at::kFloat) return Linear(input, weight, bias);
  const at::Tensor output = at::linear(input.to(weight.scalar_type()), weight).to(at::kFloat);
  return bias.defined() ? output + bias : output;
}

}  // namespace

LinearLayer::LinearLayer(const std::string& name, int64_t inputs, int64_t outputs, ParamInit init, Bias bias,
                         ParamList* params)
    : weight_(params->Add(name + ".weight", {outputs, inputs}, init)),
      bias_(AddBias(name, outputs, bias, init, params)) {}

at::Tensor LinearLayer::Forward(const ParamTensors& params, const at::Tensor& input) const {
  const at::Tensor bias = BiasOf(params, bias_);
  if (input.dim() == 2 && bias.defined() && WideLinearFits(params[weight_], params.multiplied_as)) {
    const PreparedWeight* const prepared = params.FindPrepared(weight_);
    return WideLinear(input, params[weight_], prepared != nullptr ? prepared->for_output : params.Multiplied(weight_),
                      bias, params.FindWideFactors(weight_));
  }
  const at::Tensor weight = params.Multiplied(weight_);
  if (input.dim() == 2) return LinearAs(input, weight, bias);
  std::vector<int64_t> shape = input.sizes().vec();
  shape.back() = weight.size(0);
  return LinearAs(input.reshape({-1, weight.size(1)}), weight, bias).view(shape);
}

void LinearLayer::Prepare(const ParamTensors& params, Preparation* preparation) const {
  constexpr int64_t kRowsAtOnce = 32;
  const at::Tensor& weight = params[weight_];
  const bool is_ready = params.multiplied_as == at::kFloat || !params.converted.empty();
  if (is_ready || !WideLinearFits(weight, params.multiplied_as)) return;
  const at::Tensor rounded = RoundedTensor(weight.sizes());
  preparation->weights.by_weight[weight_] = {rounded, at::Tensor()};
  for (int64_t row = 0; row < weight.size(0); row += kRowsAtOnce) {
    preparation->tasks.emplace_back([rounded, weight, row] {
      const c10::NoGradGuard no_grad;
      const int64_t end = std::min(row + kRowsAtOnce, weight.size(0));
      rounded.slice(0, row, end).copy_(weight.slice(0, row, end));
    });
  }
}

namespace {

// The prepared weight in `params`, or what `make` returns.
template <typename Make>
PreparedWeight PreparedOr(const ParamTensors& params, ParamIndex weight, const Make& make) {
  const PreparedWeight* const prepared = params.FindPrepared(weight);
  return prepared != nullptr ? *prepared : make();
}

// The weights of patches, [out,in] or the first of them, as those of a convolution: [out,C,patch,patch].
at::Tensor PatchWeight(const at::Tensor& weight, int64_t channels, int64_t patch) {
  return weight.narrow(1, 0, channels * patch * patch).view({weight.size(0), channels, patch, patch});
}

DirectShape PatchShape(const at::Tensor& weight, int64_t channels, int64_t size, int64_t patch, int64_t stride) {
  return {channels, weight.size(0), patch, stride, /*padding=*/0, size};
}

bool UsesDirectPatches(const ParamTensors& params, const at::Tensor& weight, const DirectShape& shape) {
  return weight.is_cpu() && params.multiplied_as == at::kFloat &&
         DirectConvolution::Fits(shape, /*wants_input_gradient=*/true);
}

}  // namespace

at::Tensor LinearLayer::ForwardPatches(const ParamTensors& params, const at::Tensor& map, int64_t patch, int64_t stride,
                                       const at::Tensor& tail) const {
  const at::Tensor& weight = params[weight_];
  const at::Tensor bias = BiasOf(params, bias_);
  const DirectShape shape = PatchShape(weight, map.size(1), map.size(2), patch, stride);
  const bool is_direct = UsesDirectPatches(params, weight, shape);
  if (!is_direct && weight.is_cpu()) {
    const at::Tensor patches = CutPatches(map, patch, stride);
    if (!tail.defined()) return Forward(params, patches);
    return Forward(params, at::cat({patches, tail.expand({patches.size(0), tail.size(0), tail.size(1)})}, 2));
  }
  const at::Tensor multiplied = params.Multiplied(weight_);
  const at::Tensor of_patch = PatchWeight(multiplied, map.size(1), patch);
  at::Tensor output;
  if (is_direct) {
    const PreparedWeight panels = PreparedOr(params, weight_, [&] {
      PreparedWeight made = AllocateDirectPanels(shape, weight.requires_grad());
      FillDirectPanels(shape, of_patch, made);
      return made;
    });
    output = DirectConv(shape, map, of_patch, bias.defined() ? bias : at::zeros({weight.size(0)}), Activation::kNone,
                        panels);
  } else {
    output = at::conv2d(map.to(params.multiplied_as), of_patch, {}, {stride, stride}).to(at::kFloat);
    if (bias.defined()) output = output + bias.view({1, -1, 1, 1});
  }
  const at::Tensor tokens = output.flatten(2).transpose(1, 2);
  if (!tail.defined()) return tokens;
  const int64_t width = tail.size(1);
  return tokens + LinearAs(tail, multiplied.narrow(1, weight.size(1) - width, width).contiguous(), {});
}

void LinearLayer::PreparePatches(const ParamTensors& params, int64_t channels, int64_t size, int64_t patch,
                                 int64_t stride, Preparation* preparation) const {
  const at::Tensor& weight = params[weight_];
  const DirectShape shape = PatchShape(weight, channels, size, patch, stride);
  if (!UsesDirectPatches(params, weight, shape)) return;
  const PreparedWeight panels = AllocateDirectPanels(shape, preparation->for_gradients);
  preparation->Add(weight_, panels, [shape, of_patch = PatchWeight(weight, channels, patch), panels] {
    const c10::NoGradGuard no_grad;
    FillDirectPanels(shape, of_patch, panels);
  });
}

ConvLayer::ConvLayer(const std::string& name, const Shape& shape, ParamInit init, Bias bias, ParamList* params)
    : shape_(shape),
      weight_(params->Add(name + ".weight", {shape.outputs, shape.inputs, shape.kernel, shape.kernel}, init)),
      bias_(AddBias(name, shape.outputs, bias, init, params)) {}

at::Tensor ConvLayer::Forward(const ParamTensors& params, const at::Tensor& input) const {
  const int64_t stride = shape_.stride;
  const int64_t padding = shape_.padding;
  const at::ScalarType type = params.multiplied_as;
  const at::Tensor bias = bias_ == kNoParam ? at::Tensor() : params.Multiplied(bias_);
  return at::convolution(input.to(type), params.Multiplied(weight_), bias, {stride, stride}, {padding, padding},
                         /*dilation=*/{1, 1}, /*transposed=*/false, /*output_padding=*/{0, 0}, /*groups=*/1);
}

DirectShape ConvLayer::DirectShapeFor(int64_t size) const {
  return {shape_.inputs, shape_.outputs, shape_.kernel, shape_.stride, shape_.padding, size};
}

ConvLayer::Kernels ConvLayer::KernelsFor(const ParamTensors& params, int64_t size) const {
  constexpr int64_t kChannels = FftConvolution::kChannels;
  if (!params[weight_].is_cpu() || bias_ == kNoParam) return Kernels::kLibTorch;
  if (shape_.inputs == kChannels && shape_.outputs == kChannels && shape_.kernel == FftConvolution::kKernel &&
      shape_.stride == 1 && shape_.padding == FftConvolution::kKernel / 2 && FftConvolution::Fits(size)) {
    return Kernels::kFft;
  }
  return DirectConvolution::Fits(DirectShapeFor(size), !sees_frames()) ? Kernels::kDirect : Kernels::kLibTorch;
}

PreparedWeight ConvLayer::Allocate(Kernels kernels, int64_t size, bool for_gradients) const {
  if (kernels == Kernels::kFft) return AllocateFftFilters(size, for_gradients);
  return AllocateDirectPanels(DirectShapeFor(size), for_gradients && !sees_frames());
}

void ConvLayer::Fill(Kernels kernels, int64_t size, const at::Tensor& weight, const PreparedWeight& prepared) const {
  if (kernels == Kernels::kFft) {
    FillFftFilters(size, weight, prepared);
  } else {
    FillDirectPanels(DirectShapeFor(size), weight, prepared);
  }
}

at::Tensor ConvLayer::ForwardRelu(const ParamTensors& params, const at::Tensor& input) const {
  const int64_t size = input.size(2);
  const Kernels kernels = size == input.size(3) ? KernelsFor(params, size) : Kernels::kLibTorch;
  if (kernels == Kernels::kLibTorch) return Forward(params, input).relu_();
  const at::Tensor& weight = params[weight_];
  const PreparedWeight prepared = PreparedOr(params, weight_, [&] {
    PreparedWeight made = Allocate(kernels, size, weight.requires_grad());
    Fill(kernels, size, weight, made);
    return made;
  });
  const at::Tensor map = input.to(at::kFloat);
  if (kernels == Kernels::kFft) return FftConvRelu(map, weight, params[bias_], prepared);
  return DirectConv(DirectShapeFor(size), map, weight, params[bias_], Activation::kRelu, prepared);
}

void ConvLayer::Prepare(const ParamTensors& params, int64_t size, Preparation* preparation) const {
  const Kernels kernels = KernelsFor(params, size);
  if (kernels == Kernels::kLibTorch) return;
  const PreparedWeight prepared = Allocate(kernels, size, preparation->for_gradients);
  preparation->Add(weight_, prepared, [layer = *this, kernels, size, weight = params[weight_], prepared] {
    layer.Fill(kernels, size, weight, prepared);
  });
}

NormLayer::NormLayer(const std::string& name, int64_t size, Over over, ParamList* params)
    : size_(size),
      over_(over),
      weight_(params->Add(name + ".weight", {size}, {ParamInit::Kind::kConstant, 1})),
      bias_(params->Add(name + ".bias", {size}, {ParamInit::Kind::kConstant, 0})) {}

at::Tensor NormLayer::Forward(const ParamTensors& params, const at::Tensor& input) const {
  if (over_ == Over::kFeatures) {
    return at::layer_norm(input, {size_}, params[weight_], params[bias_], kNormEpsilon);
  }
  if (!input.is_contiguous(at::MemoryFormat::ChannelsLast)) {
    return at::group_norm(input, /*num_groups=*/1, params[weight_], params[bias_], kNormEpsilon);
  }
  // In this layout at::group_norm adds the numbers of a channel one after the other in float32: its errors are ten
  // times as large, and a thousandth of the gradients' norms after some layers. at::layer_norm adds in a tree.
  const at::Tensor rows = input.permute({0, 2, 3, 1});
  const at::IntArrayRef map = rows.sizes().slice(1);
  return at::layer_norm(rows, map, params[weight_].expand(map), params[bias_].expand(map), kNormEpsilon)
      .permute({0, 3, 1, 2});
}

NormedLinear::NormedLinear(const std::string& name, int64_t inputs, int64_t outputs, double row_norm, ParamList* params)
    : norm_(name + ".norm", inputs, NormLayer::Over::kFeatures, params),
      linear_(name + ".layer", inputs, outputs, RowNorm(row_norm), Bias::kNone, params) {}

at::Tensor NormedLinear::Forward(const ParamTensors& params, const at::Tensor& input) const {
  return linear_.Forward(params, norm_.Forward(params, input)).relu_();
}

}  // namespace craftfleet
