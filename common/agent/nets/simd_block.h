// The accumulators of a block of a matrix product, which live in registers, for one instruction set.

#pragma once

#include <cstdint>

#include "common/agent/nets/simd.h"

namespace craftfleet::CRAFTFLEET_SIMD {

constexpr int kStripVectors = kWidth == 16 ? 4 : 2;  // of a row: six rows fill the registers
constexpr int kStrip = kStripVectors * kWidth;       // floats of a row

// What Block::Add does to a sum: sum + a b and sum - a b, rounded once.
struct Plus {
  static CRAFTFLEET_SIMD_INLINE Vector Apply(Vector a, Vector b, Vector sum) { return MulAdd(a, b, sum); }
};
struct Minus {
  static CRAFTFLEET_SIMD_INLINE Vector Apply(Vector a, Vector b, Vector sum) { return NegMulAdd(a, b, sum); }
};

// Rows x kStrip sums, which begin at 0.
template <int Rows>
struct Block {
  Vector at[Rows][kStripVectors] = {};

  // at[m] = row_of(m)[kStrip].
  template <typename RowOf>
  CRAFTFLEET_SIMD_INLINE void Begin(const RowOf& row_of) {
    CRAFTFLEET_UNROLL
    for (int m = 0; m < Rows; ++m) {
      CRAFTFLEET_UNROLL
      for (int n = 0; n < kStripVectors; ++n) at[m][n] = Load(row_of(m) + n * kWidth);
    }
  }

  // at[m] = Op::Apply(factor_of(m), b[kStrip], at[m]).
  template <typename Op, typename FactorOf>
  CRAFTFLEET_SIMD_INLINE void Add(const FactorOf& factor_of, const float* b) {
    Vector row[kStripVectors];
    CRAFTFLEET_UNROLL
    for (int n = 0; n < kStripVectors; ++n) row[n] = Load(b + n * kWidth);
    CRAFTFLEET_UNROLL
    for (int m = 0; m < Rows; ++m) {
      const Vector factor = Broadcast(factor_of(m));
      CRAFTFLEET_UNROLL
      for (int n = 0; n < kStripVectors; ++n) at[m][n] = Op::Apply(factor, row[n], at[m][n]);
    }
  }

  // Calls write(row_of(m) + n, vector) for all vectors.
  template <typename RowOf, typename Write>
  CRAFTFLEET_SIMD_INLINE void End(const RowOf& row_of, const Write& write) const {
    CRAFTFLEET_UNROLL
    for (int m = 0; m < Rows; ++m) {
      float* const row = row_of(m);
      CRAFTFLEET_UNROLL
      for (int n = 0; n < kStripVectors; ++n) write(row + n * kWidth, at[m][n]);
    }
  }
};

template <int N>
struct RowCount {
  static constexpr int kRows = N;
};

// Takes rows 0..rows-1 as blocks of six, as few as possible of four or one at the end: take(RowCount<N>(), first row).
template <typename Take>
CRAFTFLEET_SIMD_INLINE void ForBlocks(int64_t rows, const Take& take) {
  int64_t row = 0;
  for (; rows - row >= 6 && rows - row != 8; row += 6) take(RowCount<6>(), row);
  for (; rows - row >= 4; row += 4) take(RowCount<4>(), row);
  for (; row < rows; ++row) take(RowCount<1>(), row);
}

}  // namespace craftfleet::CRAFTFLEET_SIMD
