#include "common/agent/nets/layers.h"

#include <vector>

#include <ATen/ATen.h>

#include "common/agent/linear.h"
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

}  // namespace

LinearLayer::LinearLayer(const std::string& name, int64_t inputs, int64_t outputs, ParamInit init, Bias bias,
                         ParamList* params)
    : weight_(params->Add(name + ".weight", {outputs, inputs}, init)),
      bias_(AddBias(name, outputs, bias, init, params)) {}

at::Tensor LinearLayer::Forward(const ParamTensors& params, const at::Tensor& input) const {
  const at::Tensor& weight = params[weight_];
  if (input.dim() == 2) return Linear(input, weight, BiasOf(params, bias_));
  std::vector<int64_t> shape = input.sizes().vec();
  shape.back() = weight.size(0);
  return Linear(input.reshape({-1, weight.size(1)}), weight, BiasOf(params, bias_)).view(shape);
}

ConvLayer::ConvLayer(const std::string& name, const Shape& shape, ParamInit init, Bias bias, ParamList* params)
    : shape_(shape),
      weight_(params->Add(name + ".weight", {shape.outputs, shape.inputs, shape.kernel, shape.kernel}, init)),
      bias_(AddBias(name, shape.outputs, bias, init, params)) {}

at::Tensor ConvLayer::Forward(const ParamTensors& params, const at::Tensor& input) const {
  const int64_t stride = shape_.stride;
  const int64_t padding = shape_.padding;
  return at::convolution(input, params[weight_], BiasOf(params, bias_), {stride, stride}, {padding, padding},
                         /*dilation=*/{1, 1}, /*transposed=*/false, /*output_padding=*/{0, 0}, /*groups=*/1);
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
  return at::group_norm(input, /*num_groups=*/1, params[weight_], params[bias_], kNormEpsilon);
}

}  // namespace craftfleet
