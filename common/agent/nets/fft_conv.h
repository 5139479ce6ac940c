// A convolution with ReLU by FFT (fft_convolution/) on tensors, with autograd. Includes LibTorch's tensors.

#pragma once

#include <cstdint>

#include <ATen/core/Tensor.h>

#include "common/agent/nets/prepared_weights.h"

namespace craftfleet {

// Memory for the spectra of a weight, for maps of `size` pixels a side, which FftConvolution fits, and what fills them:
// weight float[64,64,5,5].
PreparedWeight AllocateFftFilters(int64_t size, bool for_gradients);
void FillFftFilters(int64_t size, const at::Tensor& weight, const PreparedWeight& filters);

// max(input * weight + bias, 0): input float[N,64,S,S] on the CPU, of a size that FftConvolution fits, bias float[64]
// -> float[N,64,S,S], channels last. `filters` are those of the weight, with gradients if autograd records.
at::Tensor FftConvRelu(const at::Tensor& input, const at::Tensor& weight, const at::Tensor& bias,
                       const PreparedWeight& filters);

}  // namespace craftfleet
