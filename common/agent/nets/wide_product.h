// The products of a linear layer whose weight is too large for a CPU's caches, float[outputs][inputs]:
//     Y[i, o] = sum over k of X[i, k] W[o, k],   X'[i, k] = sum over o of Y'[i, o] W[o, k],
//     W'[o, k] = sum over i of Y'[i, o] X[i, k].
// Each reads or writes the weight once, a column of 64 inputs after the other. A row of Y and X' depends on nothing but
// its own numbers and the weight: not on the other rows, the number of threads or, for float, the instruction set.
// X, W and Y' are float or bfloat16; sums are float32.

#pragma once

#include <cstdint>

#include <absl/types/span.h>

#include "common/agent/nets/product_kernels.h"

namespace craftfleet {

using Bfloat16 = uint16_t;  // its bits

// Number: float or Bfloat16. Immutable and thread-safe. Arrays are row-major; inputs' and weight's gradients are
// aligned to 64 bytes, others to 4.
template <typename Number>
class WideProduct {
 public:
  static constexpr int64_t kColumns = ProductKernels::kColumns;

  static constexpr int64_t kMinRows = 32;  // below, most of what Forward computes would be padding

  // Whether this CPU has the kernels, and a library's products are slower: the weight has at least 16M numbers.
  // `inputs` is then a multiple of kColumns, and there are whole words of outputs.
  static bool Fits(int64_t inputs, int64_t outputs);

  // Fits(inputs, outputs) is true.
  WideProduct(int64_t inputs, int64_t outputs) : inputs_(inputs), outputs_(outputs), kernels_(*FindKernels()) {}

  // input [rows][inputs] -> output [rows][outputs].
  void Forward(int64_t rows, const Number* input, const Number* weight, float* output) const;

  // output_gradient [rows][outputs] -> input_gradient [rows][inputs].
  void InputGradient(int64_t rows, const Number* output_gradient, const Number* weight, float* input_gradient) const;

  // The rows that one shard adds to the weight's gradient.
  struct Rows {
    int64_t count;
    const Number* output_gradient;  // [count][outputs]
    const Number* input;            // [count][inputs]
  };
  // The columns begin..end-1, multiples of kColumns, of the weight's gradient [outputs][inputs]: each shard's sum,
  // added in their order. `parts`: where the gradient is, cut into as many stretches of as many outputs each.
  void WeightGradient(absl::Span<const Rows> shards, int64_t begin, int64_t end, absl::Span<float* const> parts) const;

 private:
  static constexpr int64_t kWord = sizeof(float) / sizeof(Number);  // numbers that kernels take at once

  // Null: this CPU has none.
  static const ProductKernels* FindKernels();

  int64_t inputs_;
  int64_t outputs_;
  const ProductKernels& kernels_;
};

}  // namespace craftfleet
