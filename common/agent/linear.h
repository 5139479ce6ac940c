// A linear layer with autograd, multiplied by oneDNN instead of the BLAS.

#pragma once

#include <ATen/core/Tensor.h>

namespace craftfleet {

// input float[N,in] * weight float[out,in]^T + bias float[out], if it is defined -> float[N,out].
//
// Debian's OpenBLAS 0.3.21 runs SSE3 kernels on CPUs that are newer than itself; oneDNN, which is part of LibTorch,
// is 4-5 times as fast there and up to 1.3 times where OpenBLAS supports the CPU. Without dnnl_sgemm in the
// process (LibTorch's own binaries hide it) the product is at::mm. Tensors of a GPU go to at::linear.
at::Tensor Linear(const at::Tensor& input, const at::Tensor& weight, const at::Tensor& bias);

enum class Form { kPlain, kTransposed };

// c = op(a) * op(b) + beta * c in place, without autograd; beta is 0 or 1, all three contiguous matrices. As Linear
// multiplies.
void MultiplyInto(Form form_a, const at::Tensor& a, Form form_b, const at::Tensor& b, float beta, at::Tensor* c);

// Linear's output of rows on the CPU, contiguous, without autograd. An undefined bias is none.
at::Tensor LinearOutput(const at::Tensor& rows, const at::Tensor& weight, const at::Tensor& bias);

// Whether Linear runs on oneDNN, so that the BLAS does not matter.
bool LinearUsesOneDnn();

}  // namespace craftfleet
