// The functions that self- and cross-attention share. Includes LibTorch's tensors.

#pragma once

#include <cstdint>
#include <optional>

#include <ATen/core/Tensor.h>
#include <c10/core/Device.h>

#include "common/agent/nets/part.h"

namespace craftfleet {

constexpr int64_t kAttentionWidth = 256;  // of queries, keys and values, all heads together

// map float[N,C,H,W] -> float[N,patches,C*patch*patch]: squares of `patch` pixels every `stride` pixels, row by row,
// each flattened in the order C,H,W. Pixels left over at the right and the bottom are ignored.
at::Tensor CutPatches(const at::Tensor& map, int64_t patch, int64_t stride);

// What the dropout of attention weights multiplies them by, float[N,...]: 0 with `probability`, else
// 1 / (1 - probability), a function of the key, the layer and each weight's place alone. Both give the same numbers:
// the first computes them one by one on the CPU, the second by tensors on any device.
at::Tensor DropoutMask(at::IntArrayRef shape, double probability, int64_t layer, const Dropout& dropout);
at::Tensor DropoutMaskOnDevice(at::IntArrayRef shape, double probability, int64_t layer, const Dropout& dropout,
                               at::Device device);

struct AttentionOptions {
  int64_t heads = 1;            // divides kAttentionWidth
  bool competition = false;     // softmax over queries, then each query's weights divided by their sum
  double drop_probability = 0;  // of a weight, in training
  int64_t layer = 0;            // in its network: layers drop independently
};

// softmax(q k^T / sqrt(width of a head)): queries float[N,Q,256] or [Q,256] for every row, keys float[N,T,256] ->
// float[N,heads,Q,T], how much each query of each head attends to each token. Nothing is dropped.
at::Tensor AttentionWeights(const at::Tensor& queries, const at::Tensor& keys, const AttentionOptions& options);

// These weights times the values, heads side by side: values float[N,T,256] -> float[N,Q,256]. Kept weights are divided
// by the probability to be kept.
at::Tensor Attend(const at::Tensor& queries, const at::Tensor& keys, const at::Tensor& values,
                  const AttentionOptions& options, const std::optional<Dropout>& dropout);

}  // namespace craftfleet
