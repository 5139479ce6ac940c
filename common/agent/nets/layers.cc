#include "common/agent/nets/layers.h"

#include <vector>

#include <ATen/ATen.h>

#include "common/agent/linear.h"
#include "common/agent/nets/fft_conv.h"
#include "common/agent/nets/fft_convolution/fft_convolution.h"
#include "common/agent/nets/param_tensors.h"

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

// Linear (common/agent/linear.h), multiplied as `type`: float[N,out].
at::Tensor LinearAs(at::ScalarType type, const at::Tensor& input, const at::Tensor& weight, const at::Tensor& bias) {
  if (type == at::kFloat) return Linear(input, weight, bias);
  const at::Tensor output = at::linear(input.to(type), weight.to(type)).to(at::kFloat);
  return bias.defined() ? output + bias : output;
}

}  // namespace

LinearLayer::LinearLayer(const std::string& name, int64_t inputs, int64_t outputs, ParamInit init, Bias bias,
                         ParamList* params)
    : weight_(params->Add(name + ".weight", {outputs, inputs}, init)),
      bias_(AddBias(name, outputs, bias, init, params)) {}

at::Tensor LinearLayer::Forward(const ParamTensors& params, const at::Tensor& input) const {
  const at::Tensor& weight = params[weight_];
  const at::Tensor bias = BiasOf(params, bias_);
  if (input.dim() == 2) return LinearAs(params.multiplied_as, input, weight, bias);
  std::vector<int64_t> shape = input.sizes().vec();
  shape.back() = weight.size(0);
  return LinearAs(params.multiplied_as, input.reshape({-1, weight.size(1)}), weight, bias).view(shape);
}

ConvLayer::ConvLayer(const std::string& name, const Shape& shape, ParamInit init, Bias bias, ParamList* params)
    : shape_(shape),
      weight_(params->Add(name + ".weight", {shape.outputs, shape.inputs, shape.kernel, shape.kernel}, init)),
      bias_(AddBias(name, shape.outputs, bias, init, params)) {}

at::Tensor ConvLayer::Forward(const ParamTensors& params, const at::Tensor& input) const {
  const int64_t stride = shape_.stride;
  const int64_t padding = shape_.padding;
  const at::ScalarType type = params.multiplied_as;
  const at::Tensor bias = BiasOf(params, bias_);
  return at::convolution(input.to(type), params[weight_].to(type), bias.defined() ? bias.to(type) : bias,
                         {stride, stride}, {padding, padding},
                         /*dilation=*/{1, 1}, /*transposed=*/false, /*output_padding=*/{0, 0}, /*groups=*/1);
}

bool ConvLayer::FitsFft(const ParamTensors& params, int64_t height, int64_t width) const {
  constexpr int64_t kChannels = FftConvolution::kChannels;
  return shape_.inputs == kChannels && shape_.outputs == kChannels && shape_.kernel == FftConvolution::kKernel &&
         shape_.stride == 1 && shape_.padding == FftConvolution::kKernel / 2 && bias_ != kNoParam && height == width &&
         params[weight_].is_cpu() && FftConvolution::Fits(height);
}

at::Tensor ConvLayer::ForwardRelu(const ParamTensors& params, const at::Tensor& input) const {
  if (!FitsFft(params, input.size(2), input.size(3))) return Forward(params, input).relu_();
  const at::Tensor& weight = params[weight_];
  if (params.prepared != nullptr) {
    const auto found = params.prepared->filters.find(weight_);
    if (found != params.prepared->filters.end()) {
      return FftConvRelu(input.to(at::kFloat), weight, params[bias_], found->second);
    }
  }
  const FftFilters filters = AllocateFftFilters(input.size(2), weight.requires_grad());
  FillFftFilters(input.size(2), weight, filters);
  return FftConvRelu(input.to(at::kFloat), weight, params[bias_], filters);
}

void ConvLayer::Prepare(const ParamTensors& params, int64_t size, bool for_gradients, PreparedWeights* prepared,
                        std::vector<std::function<void()>>* tasks) const {
  if (!FitsFft(params, size, size)) return;
  const FftFilters filters = AllocateFftFilters(size, for_gradients);
  prepared->filters[weight_] = filters;
  tasks->push_back([size, weight = params[weight_], filters] { FillFftFilters(size, weight, filters); });
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
