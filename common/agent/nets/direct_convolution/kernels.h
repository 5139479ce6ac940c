// The kernels of a convolution as one product, compiled for AVX-512 and for AVX2. Both compute the same bits.

#pragma once

#include <cstdint>

#include "common/agent/nets/product_kernels.h"
#include "common/base/cpu_path.h"

namespace craftfleet {

// Arrays are aligned to 64 bytes.
struct DirectKernels : ProductKernels {
  // values[i][64] += bias[64]; with a mask also max(.., 0), and bit i step + o says whether it is positive. Rows are
  // `step` floats apart; `bias` may be at any address.
  void (*finish)(int64_t count, int64_t step, const float* bias, float* values, uint8_t* mask);
  // kept[i] = values[i] where bit i of the mask is 1, else 0. `count` is a multiple of 64.
  void (*keep)(int64_t count, const float* values, const uint8_t* mask, float* kept);
};

// Null: `path` is the base CPU.
const DirectKernels* FindDirectKernels(CpuPath path);

namespace avx512 {
const DirectKernels* FindDirectKernels();
}
namespace avx2 {
const DirectKernels* FindDirectKernels();
}

}  // namespace craftfleet
