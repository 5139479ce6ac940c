// Compiled for AVX512-BF16.

#if defined(__x86_64__)
#include "common/agent/nets/product_kernels.h"
#include "common/agent/nets/simd_products.h"

namespace craftfleet::avx512 {
namespace {

// Of pairs of bfloat16: sum + a[1] b[1] + a[0] b[0] in each place, rounded as the instruction does.
struct PlusPairs {
  static CRAFTFLEET_SIMD_INLINE Vector Apply(Vector a, Vector b, Vector sum) {
    return _mm512_dpbf16_ps(sum, reinterpret_cast<__m512bh>(a), reinterpret_cast<__m512bh>(b));
  }
};

}  // namespace

const ProductKernels* FindBf16Kernels() {
  static constexpr ProductKernels kKernels = {MultiplyRows<PlusPairs>, CorrelateRows<PlusPairs>};
  return &kKernels;
}

}  // namespace craftfleet::avx512
#endif
