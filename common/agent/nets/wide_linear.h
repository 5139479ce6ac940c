// A linear layer whose weight is too large for a CPU's caches, with autograd. Includes LibTorch's tensors.

#ifndef CRAFTFLEET_COMMON_AGENT_NETS_WIDE_LINEAR_H_
#define CRAFTFLEET_COMMON_AGENT_NETS_WIDE_LINEAR_H_

#include <ATen/core/Tensor.h>
#include <ATen/core/ivalue.h>
#include <c10/util/intrusive_ptr.h>

namespace craftfleet {

// The factors of a weight's gradient, output_gradient^T input, as a backward pass leaves them. Undefined before it.
struct WideFactors : torch::CustomClassHolder {
  at::Tensor output_gradient;  // float[N,out]
  at::Tensor input;            // float[N,in]
};

// Whether WideLinear computes with such a weight, float[out,in].
bool WideLinearFits(const at::Tensor& weight);

// As Linear (common/agent/linear.h). With `factors`, the weight gets no gradient: its factors go there.
at::Tensor WideLinear(const at::Tensor& input, const at::Tensor& weight, const at::Tensor& bias,
                      const c10::intrusive_ptr<WideFactors>& factors);

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_AGENT_NETS_WIDE_LINEAR_H_
