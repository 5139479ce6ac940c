// A linear layer whose weight is too large for a CPU's caches, with autograd. Includes LibTorch's tensors.

#pragma once

#include <cstdint>

#include <ATen/core/Tensor.h>
#include <ATen/core/ivalue.h>
#include <absl/types/span.h>
#include <c10/core/ScalarType.h>
#include <c10/util/intrusive_ptr.h>

namespace craftfleet {

// The factors of a weight's gradient, output_gradient^T input, as a backward pass leaves them: as they are multiplied,
// float or bfloat16. Undefined before it.
struct WideFactors : torch::CustomClassHolder {
  at::Tensor output_gradient;  // [N,out]
  at::Tensor input;            // [N,in]
};

// Whether WideLinear computes with such a weight, float[out,in], multiplied as `type`: float or bfloat16.
bool WideLinearFits(const at::Tensor& weight, at::ScalarType type);

// As Linear (common/agent/linear.h), multiplied as `multiplied` is: the weight, or the weight rounded to bfloat16. With
// `factors`, the weight gets no gradient: its factors go there.
at::Tensor WideLinear(const at::Tensor& input, const at::Tensor& weight, const at::Tensor& multiplied,
                      const at::Tensor& bias, const c10::intrusive_ptr<WideFactors>& factors);

// The columns begin..end-1 of the sum of these gradients, as WideProduct::WeightGradient.
void WideWeightGradient(absl::Span<const WideFactors* const> shards, int64_t begin, int64_t end,
                        absl::Span<float* const> parts);

}  // namespace craftfleet
