// A convolution as one product (direct_convolution/) on tensors, with autograd. Includes LibTorch's tensors.

#pragma once

#include <ATen/core/Tensor.h>

#include "common/agent/nets/direct_convolution/direct_convolution.h"
#include "common/agent/nets/prepared_weights.h"

namespace craftfleet {

// Memory for the panels of a weight, float[out,in,kernel,kernel], and what fills them.
PreparedWeight AllocateDirectPanels(const DirectShape& shape, bool wants_input_gradient);
void FillDirectPanels(const DirectShape& shape, const at::Tensor& weight, const PreparedWeight& panels);

enum class Activation { kNone, kRelu };

// input * weight + bias, and its ReLU: input float[N,C,S,S] on the CPU, of a shape that DirectConvolution fits, bias
// float[out] -> float[N,out,S',S'], channels last. `panels` are those of the weight.
at::Tensor DirectConv(const DirectShape& shape, const at::Tensor& input, const at::Tensor& weight,
                      const at::Tensor& bias, Activation activation, const PreparedWeight& panels);

}  // namespace craftfleet
