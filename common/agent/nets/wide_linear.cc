#include "common/agent/nets/wide_linear.h"

#include <cstdint>

#include <ATen/ATen.h>
#include <torch/csrc/autograd/custom_function.h>

#include "common/agent/linear.h"
#include "common/agent/nets/map_tensors.h"
#include "common/agent/nets/wide_product.h"

namespace craftfleet {
namespace {

WideProduct ProductOf(const at::Tensor& weight) { return {weight.size(1), weight.size(0)}; }

struct WideLinearFunction : torch::autograd::Function<WideLinearFunction> {
  // NOLINTNEXTLINE(readability-identifier-naming): the name that autograd calls
  static at::Tensor forward(torch::autograd::AutogradContext* context, const at::Tensor& input,
                            const at::Tensor& weight, const at::Tensor& bias,
                            const c10::intrusive_ptr<WideFactors>& factors) {
    const at::Tensor rows = input.contiguous();
    context->save_for_backward({rows, weight});
    if (factors != nullptr) context->saved_data["factors"] = c10::IValue::make_capsule(factors);
    if (rows.size(0) < WideProduct::kMinRows) return LinearOutput(rows, weight, bias);
    at::Tensor output = at::empty({rows.size(0), weight.size(0)});
    ProductOf(weight).Forward(rows.size(0), DataOf(rows), DataOf(weight), DataOf(output));
    return output.add_(bias);
  }

  // NOLINTNEXTLINE(readability-identifier-naming): the name that autograd calls
  static torch::autograd::variable_list backward(torch::autograd::AutogradContext* context,
                                                 torch::autograd::variable_list output_gradients) {
    const torch::autograd::variable_list saved = context->get_saved_variables();
    const at::Tensor& input = saved[0];
    const at::Tensor& weight = saved[1];
    const at::Tensor gradient = output_gradients[0].contiguous();
    const WideProduct product = ProductOf(weight);
    const int64_t rows = input.size(0);
    const at::Tensor input_gradient = at::empty_like(input);
    product.InputGradient(rows, DataOf(gradient), DataOf(weight), DataOf(input_gradient));
    at::Tensor weight_gradient;
    if (const auto found = context->saved_data.find("factors"); found != context->saved_data.end()) {
      const auto factors = c10::static_intrusive_pointer_cast<WideFactors>(found->second.toCapsule());
      factors->output_gradient = gradient;
      factors->input = input;
    } else {
      weight_gradient = at::empty_like(weight);
      product.WeightGradient({{rows, DataOf(gradient), DataOf(input)}}, 0, weight.size(1), {DataOf(weight_gradient)});
    }
    return {input_gradient, weight_gradient, gradient.sum(0), at::Tensor()};
  }
};

}  // namespace

bool WideLinearFits(const at::Tensor& weight) {
  return weight.is_cpu() && weight.dim() == 2 && weight.is_contiguous() &&
         WideProduct::Fits(weight.size(1), weight.size(0));
}

at::Tensor WideLinear(const at::Tensor& input, const at::Tensor& weight, const at::Tensor& bias,
                      const c10::intrusive_ptr<WideFactors>& factors) {
  return WideLinearFunction::apply(input, weight, bias, factors);
}

}  // namespace craftfleet
