// The kernels of a convolution as one product, compiled for AVX-512 and for AVX2. Both compute the same bits.

#ifndef CRAFTFLEET_COMMON_AGENT_NETS_DIRECT_CONVOLUTION_KERNELS_H_
#define CRAFTFLEET_COMMON_AGENT_NETS_DIRECT_CONVOLUTION_KERNELS_H_

#include <cstdint>

#include "common/base/cpu_path.h"

namespace craftfleet {

// A row of a factor: `count` stretches of `floats` numbers, `step` floats apart.
struct Stretches {
  int64_t count;
  int64_t floats;
  int64_t step;
};

// Each sum begins at zero and is in order; what it is added to comes last. Arrays are aligned to 64 bytes, but for
// rows whose numbers are taken one by one: those of `multiply`, `correlate`.
struct DirectKernels {
  static constexpr int kColumns = 64;

  // outputs[i][64] = or += sum over k of rows[i][k] b[k][64], where k goes through the stretches.
  void (*multiply)(int64_t count, const float* const* rows, Stretches stretches, const float* b, bool adds,
                   float* const* outputs);
  // sums[k][64] = or += sum over i of rows[i][k] b[i][64], for k < depth; rows of b and of the sums are `b_step` and
  // `sums_step` floats apart.
  void (*correlate)(int64_t count, const float* const* rows, int64_t depth, const float* b, int64_t b_step, bool adds,
                    float* sums, int64_t sums_step);
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

#endif  // CRAFTFLEET_COMMON_AGENT_NETS_DIRECT_CONVOLUTION_KERNELS_H_
