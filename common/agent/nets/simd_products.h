// The kernels of matrix products for one instruction set, with Op as Block::Add.

#pragma once

#include <cstdint>

#include "common/agent/nets/product_kernels.h"
#include "common/agent/nets/simd.h"
#include "common/agent/nets/simd_block.h"

namespace craftfleet::CRAFTFLEET_SIMD {

constexpr int kColumns = ProductKernels::kColumns;

// row_of(m)[kStrip] = or += the block.
template <int Rows, typename RowOf>
CRAFTFLEET_SIMD_INLINE void Write(const Block<Rows>& block, bool adds, const RowOf& row_of) {
  block.End(row_of, [&](float* to, Vector v) { Store(to, adds ? v + Load(to) : v); });
}

template <typename Op, int Rows>
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
        sums.template Add<Op>([&](int m) { return row[m][k]; }, from);
        from += kColumns;
      }
    }
    Write(sums, adds, [&](int m) { return outputs[m] + column; });
  }
}

template <typename Op>
void MultiplyRows(int64_t count, const float* const* rows, Stretches stretches, const float* b, bool adds,
                  float* const* outputs) {
  ForBlocks(count, [&](auto block, int64_t i) {
    MultiplyBlock<Op, decltype(block)::kRows>(rows + i, stretches, b, adds, outputs + i);
  });
}

template <typename Op, int Depth>
__attribute__((noinline)) void CorrelateBlock(int64_t count, const float* const* rows, int64_t first, const float* b,
                                              int64_t b_step, bool adds, float* sums, int64_t sums_step) {
  for (int column = 0; column < kColumns; column += kStrip) {
    Block<Depth> block;
    const float* from = b + column;
    for (int64_t i = 0; i < count; ++i) {
      const float* const row = rows[i] + first;
      block.template Add<Op>([&](int m) { return row[m]; }, from);
      from += b_step;
    }
    Write(block, adds, [&](int m) { return sums + (first + m) * sums_step + column; });
  }
}

template <typename Op>
void CorrelateRows(int64_t count, const float* const* rows, int64_t depth, const float* b, int64_t b_step, bool adds,
                   float* sums, int64_t sums_step) {
  ForBlocks(depth, [&](auto block, int64_t k) {
    CorrelateBlock<Op, decltype(block)::kRows>(count, rows, k, b, b_step, adds, sums, sums_step);
  });
}

}  // namespace craftfleet::CRAFTFLEET_SIMD
