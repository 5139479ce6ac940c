// The kernels of one instruction set. Included by kernels_avx2.cc and kernels_avx512.cc alone.

#ifndef CRAFTFLEET_COMMON_AGENT_NETS_DIRECT_CONVOLUTION_SIMD_KERNELS_H_
#define CRAFTFLEET_COMMON_AGENT_NETS_DIRECT_CONVOLUTION_SIMD_KERNELS_H_

#include <cstdint>

#include "common/agent/nets/direct_convolution/kernels.h"
#include "common/agent/nets/simd.h"

namespace craftfleet::CRAFTFLEET_SIMD {

constexpr int kColumns = DirectKernels::kColumns;
constexpr int kStripVectors = kWidth == 16 ? 4 : 2;  // of a row that accumulators hold: 6 x 4 or 6 x 2
constexpr int kStrip = kStripVectors * kWidth;

// Accumulators: Rows x kStrip numbers.
template <int Rows>
struct Sums {
  Vector at[Rows][kStripVectors] = {};

  // at[m] += factor_of(m) * b[kStrip].
  template <typename FactorOf>
  CRAFTFLEET_SIMD_INLINE void Add(const FactorOf& factor_of, const float* b) {
    Vector row[kStripVectors];
    CRAFTFLEET_UNROLL
    for (int n = 0; n < kStripVectors; ++n) row[n] = Load(b + n * kWidth);
    CRAFTFLEET_UNROLL
    for (int m = 0; m < Rows; ++m) {
      const Vector factor = Broadcast(factor_of(m));
      CRAFTFLEET_UNROLL
      for (int n = 0; n < kStripVectors; ++n) at[m][n] = MulAdd(factor, row[n], at[m][n]);
    }
  }

  // row_of(m) = or += at[m].
  template <typename RowOf>
  CRAFTFLEET_SIMD_INLINE void Write(bool adds, const RowOf& row_of) const {
    CRAFTFLEET_UNROLL
    for (int m = 0; m < Rows; ++m) {
      float* const to = row_of(m);
      CRAFTFLEET_UNROLL
      for (int n = 0; n < kStripVectors; ++n) {
        Store(to + n * kWidth, adds ? at[m][n] + Load(to + n * kWidth) : at[m][n]);
      }
    }
  }
};

template <int Rows>
__attribute__((noinline)) void MultiplyBlock(const float* const* rows, Stretches stretches, const float* b, bool adds,
                                             float* const* outputs) {
  for (int column = 0; column < kColumns; column += kStrip) {
    Sums<Rows> sums;
    const float* from = b + column;
    for (int stretch = 0; stretch < stretches.count; ++stretch) {
      const float* row[Rows];
      CRAFTFLEET_UNROLL
      for (int m = 0; m < Rows; ++m) row[m] = rows[m] + stretch * stretches.step;
      for (int k = 0; k < stretches.floats; ++k) {
        sums.Add([&](int m) { return row[m][k]; }, from);
        from += kColumns;
      }
    }
    sums.Write(adds, [&](int m) { return outputs[m] + column; });
  }
}

inline void MultiplyRows(int count, const float* const* rows, Stretches stretches, const float* b, bool adds,
                         float* const* outputs) {
  int i = 0;
  for (; count - i >= 6 && count - i != 8; i += 6) MultiplyBlock<6>(rows + i, stretches, b, adds, outputs + i);
  for (; count - i >= 4; i += 4) MultiplyBlock<4>(rows + i, stretches, b, adds, outputs + i);
  for (; i < count; ++i) MultiplyBlock<1>(rows + i, stretches, b, adds, outputs + i);
}

template <int Depth>
__attribute__((noinline)) void CorrelateBlock(int count, const float* const* rows, int first, const float* b,
                                              int64_t b_step, bool adds, float* sums) {
  for (int column = 0; column < kColumns; column += kStrip) {
    Sums<Depth> block;
    const float* from = b + column;
    for (int i = 0; i < count; ++i) {
      const float* const row = rows[i] + first;
      block.Add([&](int m) { return row[m]; }, from);
      from += b_step;
    }
    block.Write(adds, [&](int m) { return sums + (first + m) * kColumns + column; });
  }
}

inline void CorrelateRows(int count, const float* const* rows, int depth, const float* b, int64_t b_step, bool adds,
                          float* sums) {
  int k = 0;
  for (; depth - k >= 6 && depth - k != 8; k += 6) CorrelateBlock<6>(count, rows, k, b, b_step, adds, sums);
  for (; depth - k >= 4; k += 4) CorrelateBlock<4>(count, rows, k, b, b_step, adds, sums);
  for (; k < depth; ++k) CorrelateBlock<1>(count, rows, k, b, b_step, adds, sums);
}

inline void FinishRows(int count, int64_t step, const float* bias, float* values, uint8_t* mask) {
  alignas(64) float shift[kColumns];
  std::memcpy(shift, bias, sizeof(shift));
  for (int i = 0; i < count; ++i) {
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
