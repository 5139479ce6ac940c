// The kernels of matrix products, compiled for AVX-512 and for AVX2, which compute the same bits, and for AVX512-BF16.

#pragma once

#include <cstdint>
#include <vector>

namespace craftfleet {

// A row of a factor: `count` stretches of `floats` numbers, `step` floats apart.
struct Stretches {
  int64_t count;
  int64_t floats;
  int64_t step;
};

// Pointers to `count` rows that are `step` numbers apart.
template <typename Number>
std::vector<Number*> RowPointers(int64_t count, Number* first, int64_t step) {
  std::vector<Number*> rows(count);
  for (int64_t i = 0; i < count; ++i) rows[i] = first + i * step;
  return rows;
}

// Each sum begins at zero and is in order; what it is added to comes last. Arrays are aligned to 64 bytes, but for
// rows whose numbers are taken one by one: those of `multiply`, `correlate`. With AVX512-BF16, a number of a factor
// stands for two of bfloat16 that follow each other in a sum; sums are float32.
struct ProductKernels {
  static constexpr int kColumns = 64;

  // outputs[i][64] = or += sum over k of rows[i][k] b[k][64], where k goes through the stretches.
  void (*multiply)(int64_t count, const float* const* rows, Stretches stretches, const float* b, bool adds,
                   float* const* outputs);
  // sums[k][64] = or += sum over i of rows[i][k] b[i][64], for k < depth; rows of b and of the sums are `b_step` and
  // `sums_step` floats apart.
  void (*correlate)(int64_t count, const float* const* rows, int64_t depth, const float* b, int64_t b_step, bool adds,
                    float* sums, int64_t sums_step);
};

// Null: this CPU has no AVX512-BF16, or is to compute without AVX-512 (CurrentCpuPath), or has AMX, whose products
// LibTorch uses.
const ProductKernels* FindBf16Kernels();

namespace avx512 {
const ProductKernels* FindBf16Kernels();
}

}  // namespace craftfleet
