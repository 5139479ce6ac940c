// Maps and their memory, for layers with kernels of their own. Includes LibTorch's tensors.

#pragma once

#include <ATen/core/Tensor.h>

namespace craftfleet {

// Uninitialised, float[shape], in memory of a PooledBuffer.
at::Tensor PooledTensor(at::IntArrayRef shape);

// The same, bfloat16[rows,numbers]; an even number of them.
at::Tensor RoundedTensor(at::IntArrayRef shape);

// A map [N,C,H,W] -> its pixels [N,H,W,C], contiguous and aligned to 64 bytes.
at::Tensor PixelsOf(const at::Tensor& map);

// Pixels [N,H,W,C] -> the map [N,C,H,W], channels last.
at::Tensor MapOf(const at::Tensor& pixels);

// The numbers of a tensor of floats; null for an undefined one.
float* DataOf(const at::Tensor& tensor);

}  // namespace craftfleet
