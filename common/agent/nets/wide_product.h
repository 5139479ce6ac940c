// The products of a linear layer whose weight is too large for a CPU's caches, float[outputs][inputs]:
//     Y[i, o] = sum over k of X[i, k] W[o, k],   X'[i, k] = sum over o of Y'[i, o] W[o, k],
//     W'[o, k] = sum over i of Y'[i, o] X[i, k].
// Each reads or writes the weight once, a column of 64 inputs after the other. A row of Y and X' depends on nothing but
// its own numbers and the weight: not on the other rows, the number of threads or the instruction set.

#ifndef CRAFTFLEET_COMMON_AGENT_NETS_WIDE_PRODUCT_H_
#define CRAFTFLEET_COMMON_AGENT_NETS_WIDE_PRODUCT_H_

#include <cstdint>

#include <absl/types/span.h>

#include "common/agent/nets/direct_convolution/kernels.h"

namespace craftfleet {

// Immutable and thread-safe. Arrays are row-major; inputs' and weight's gradients are aligned to 64 bytes.
class WideProduct {
 public:
  static constexpr int64_t kColumns = DirectKernels::kColumns;

  static constexpr int64_t kMinRows = 32;  // below, most of what Forward computes would be padding

  // Whether this CPU has the kernels, and a library's products are slower: the weight has at least 16M numbers.
  // `inputs` is then a multiple of kColumns.
  static bool Fits(int64_t inputs, int64_t outputs);

  // Fits(inputs, outputs) is true.
  WideProduct(int64_t inputs, int64_t outputs)
      : inputs_(inputs), outputs_(outputs), kernels_(*FindDirectKernels(CurrentCpuPath())) {}

  // input [rows][inputs] -> output [rows][outputs].
  void Forward(int64_t rows, const float* input, const float* weight, float* output) const;

  // output_gradient [rows][outputs] -> input_gradient [rows][inputs].
  void InputGradient(int64_t rows, const float* output_gradient, const float* weight, float* input_gradient) const;

  // The rows that one shard adds to the weight's gradient.
  struct Rows {
    int64_t count;
    const float* output_gradient;  // [count][outputs]
    const float* input;            // [count][inputs]
  };
  // The columns begin..end-1, multiples of kColumns, of the weight's gradient [outputs][inputs]: each shard's sum,
  // added in their order. `parts`: where the gradient is, cut into as many stretches of as many outputs each.
  void WeightGradient(absl::Span<const Rows> shards, int64_t begin, int64_t end, absl::Span<float* const> parts) const;

 private:
  int64_t inputs_;
  int64_t outputs_;
  const DirectKernels& kernels_;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_AGENT_NETS_WIDE_PRODUCT_H_
