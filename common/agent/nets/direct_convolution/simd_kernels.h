// The kernels of one instruction set. Included by kernels_avx2.cc and kernels_avx512.cc alone.

#pragma once

#include <cstdint>

#include "common/agent/nets/direct_convolution/kernels.h"
#include "common/agent/nets/simd.h"
#include "common/agent/nets/simd_products.h"

namespace craftfleet::CRAFTFLEET_SIMD {

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
  static constexpr DirectKernels kKernels = {{MultiplyRows<Plus>, CorrelateRows<Plus>}, FinishRows, KeepMasked};
  return &kKernels;
}

}  // namespace craftfleet::CRAFTFLEET_SIMD
