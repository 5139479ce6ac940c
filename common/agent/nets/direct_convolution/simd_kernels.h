// The kernels of one instruction set. Included by kernels_avx2.cc and kernels_avx512.cc alone.

#ifndef CRAFTFLEET_COMMON_AGENT_NETS_DIRECT_CONVOLUTION_SIMD_KERNELS_H_
#define CRAFTFLEET_COMMON_AGENT_NETS_DIRECT_CONVOLUTION_SIMD_KERNELS_H_

#include <cstdint>

#include "common/agent/nets/direct_convolution/kernels.h"
#include "common/agent/nets/simd.h"
#include "common/agent/nets/simd_block.h"

namespace craftfleet::CRAFTFLEET_SIMD {

constexpr int kColumns = DirectKernels::kColumns;

// row_of(m)[kStrip] = or += the block.
template <int Rows, typename RowOf>
CRAFTFLEET_SIMD_INLINE void Write(const Block<Rows>& block, bool adds, const RowOf& row_of) {
  block.End(row_of, [&](float* to, Vector v) { Store(to, adds ? v + Load(to) : v); });
}

template <int Rows>
__attribute__((noinline)) void MultiplyBlock(const float* const* rows, Stretches stretches, const float* b, bool adds,
                                             float* const* outputs) {
  for (int column = 0; column < kColumns; column += kStrip) {
    Block<Rows> sums;
    const float* from = b + column;
    for (int64_t stretch = 0; stretch < stretches.count; ++stretch) {
      const float* row[Rows];
      CRAFTFLEET_UNROLL
      for (int m = 0; m < Rows; ++m) row[m] = rows[m] + stretch * stretches.step;
      for (int64_t k = 0; k < stretches.floats; ++k) {
        sums.Add([&](int m) { return row[m][k]; }, from);
        from += kColumns;
      }
    }
    Write(sums, adds, [&](int m) { return outputs[m] + column; });
  }
}

inline void MultiplyRows(int64_t count, const float* const* rows, Stretches stretches, const float* b, bool adds,
                         float* const* outputs) {
  ForBlocks(count, [&](auto block, int64_t i) {
    MultiplyBlock<decltype(block)::kRows>(rows + i, stretches, b, adds, outputs + i);
  });
}

template <int Depth>
__attribute__((noinline)) void CorrelateBlock(int64_t count, const float* const* rows, int64_t first, const float* b,
                                              int64_t b_step, bool adds, float* sums, int64_t sums_step) {
  for (int column = 0; column < kColumns; column += kStrip) {
    Block<Depth> block;
    const float* from = b + column;
    for (int64_t i = 0; i < count; ++i) {
      const float* const row = rows[i] + first;
      block.Add([&](int m) { return row[m]; }, from);
      from += b_step;
    }
    Write(block, adds, [&](int m) { return sums + (first + m) * sums_step + column; });
  }
}

inline void CorrelateRows(int64_t count, const float* const* rows, int64_t depth, const float* b, int64_t b_step,
                          bool adds, float* sums, int64_t sums_step) {
  ForBlocks(depth, [&](auto block, int64_t k) {
    CorrelateBlock<decltype(block)::kRows>(count, rows, k, b, b_step, adds, sums, sums_step);
  });
}

inline void FinishRows(int64_t count, int64_t step, const float* bias, float* values, uint8_t* mask) {
  alignas(64) float shift[kColumns];
  std::memcpy(shift, bias, sizeof(shift));
  for (int64_t i = 0; i < count; ++i) {
    CRAFTFLEET_UNROLL
    for (int n = 0; n < kColumns; n += kWidth) {
      float* const at = values + i * step + n;
      const Vector value = Load(at) + Load(shift + n);
      Store(at, mask == nullptr ? value : CutBelow(value, Zero(), mask + (i * step + n) / 8));
    }
  }
}

inline void KeepMasked(int64_t count, const float* values, const uint8_t* mask, float* kept) {
  for (int64_t i = 0; i < count; i += kWidth) Store(kept + i, KeepWhere(Load(values + i), mask + i / 8));
}

const DirectKernels* FindDirectKernels() {
  static constexpr DirectKernels kKernels = {MultiplyRows, CorrelateRows, FinishRows, KeepMasked};
  return &kKernels;
}

}  // namespace craftfleet::CRAFTFLEET_SIMD

#endif  // CRAFTFLEET_COMMON_AGENT_NETS_DIRECT_CONVOLUTION_SIMD_KERNELS_H_
