// Vectors of floats for kernels of layers: 16 floats with AVX-512, 8 with AVX2. A file that includes this is
// compiled for one of them; what it defines lives in a namespace of that name, so that both variants link into one
// program. Arithmetic is by operators: products and sums are fused only where MulAdd says so (-ffp-contract=off), so
// each float goes through the same roundings in both variants.

#pragma once

#include <immintrin.h>

#include <cstdint>
#include <cstring>

#if defined(__AVX512F__)
#define CRAFTFLEET_SIMD avx512
#else
#define CRAFTFLEET_SIMD avx2
#endif

#define CRAFTFLEET_SIMD_INLINE inline __attribute__((always_inline))
// Before a loop of at most 36 steps that must not remain a loop: its arrays of vectors are to live in registers.
#if defined(__clang__)
#define CRAFTFLEET_UNROLL _Pragma("unroll")
#else
#define CRAFTFLEET_UNROLL _Pragma("GCC unroll 36")
#endif

namespace craftfleet::CRAFTFLEET_SIMD {

#if defined(__AVX512F__)

using Vector = __m512;
constexpr int kWidth = 16;  // floats of a vector

// Addresses are aligned to a vector.
CRAFTFLEET_SIMD_INLINE Vector Load(const float* from) { return _mm512_load_ps(from); }
CRAFTFLEET_SIMD_INLINE void Store(float* to, Vector v) { _mm512_store_ps(to, v); }
// A non-temporal store, which bypasses the caches: _mm_sfence() before other threads read what it wrote.
CRAFTFLEET_SIMD_INLINE void Stream(float* to, Vector v) { _mm512_stream_ps(to, v); }
CRAFTFLEET_SIMD_INLINE Vector Broadcast(float x) { return _mm512_set1_ps(x); }
// a b + c, rounded once.
CRAFTFLEET_SIMD_INLINE Vector MulAdd(Vector a, Vector b, Vector c) { return _mm512_fmadd_ps(a, b, c); }
// c - a b, rounded once.
CRAFTFLEET_SIMD_INLINE Vector NegMulAdd(Vector a, Vector b, Vector c) { return _mm512_fnmadd_ps(a, b, c); }
// Writes one bit a float to kWidth / 8 bytes, whether it is greater than `bound` or NaN; returns v where it is, else 0.
CRAFTFLEET_SIMD_INLINE Vector CutBelow(Vector v, Vector bound, uint8_t* bits) {
  const __mmask16 above = _mm512_cmp_ps_mask(v, bound, _CMP_NLE_UQ);
  std::memcpy(bits, &above, sizeof(above));
  return _mm512_maskz_mov_ps(above, v);
}
// v where the bit is set, else 0.
CRAFTFLEET_SIMD_INLINE Vector KeepWhere(Vector v, const uint8_t* bits) {
  __mmask16 kept;
  std::memcpy(&kept, bits, sizeof(kept));
  return _mm512_maskz_mov_ps(kept, v);
}

#else

using Vector = __m256;
constexpr int kWidth = 8;

CRAFTFLEET_SIMD_INLINE Vector Load(const float* from) { return _mm256_load_ps(from); }
CRAFTFLEET_SIMD_INLINE void Store(float* to, Vector v) { _mm256_store_ps(to, v); }
CRAFTFLEET_SIMD_INLINE void Stream(float* to, Vector v) { _mm256_stream_ps(to, v); }
CRAFTFLEET_SIMD_INLINE Vector Broadcast(float x) { return _mm256_set1_ps(x); }
CRAFTFLEET_SIMD_INLINE Vector MulAdd(Vector a, Vector b, Vector c) { return _mm256_fmadd_ps(a, b, c); }
CRAFTFLEET_SIMD_INLINE Vector NegMulAdd(Vector a, Vector b, Vector c) { return _mm256_fnmadd_ps(a, b, c); }
CRAFTFLEET_SIMD_INLINE Vector CutBelow(Vector v, Vector bound, uint8_t* bits) {
  const Vector above = _mm256_cmp_ps(v, bound, _CMP_NLE_UQ);
  *bits = static_cast<uint8_t>(_mm256_movemask_ps(above));
  return _mm256_and_ps(v, above);
}
CRAFTFLEET_SIMD_INLINE Vector KeepWhere(Vector v, const uint8_t* bits) {
  const __m256i lanes = _mm256_setr_epi32(1, 2, 4, 8, 16, 32, 64, 128);
  const __m256i kept = _mm256_cmpeq_epi32(_mm256_and_si256(_mm256_set1_epi32(*bits), lanes), lanes);
  return _mm256_and_ps(v, _mm256_castsi256_ps(kept));
}

#endif

CRAFTFLEET_SIMD_INLINE Vector Zero() { return Vector{}; }

// Loads one float of each cache line of a stretch of memory, in the order of addresses: the CPU's prefetcher follows
// such a sequence three times as fast as the order in which transforms read.
CRAFTFLEET_SIMD_INLINE void Touch(const float* begin, int64_t floats) {
  constexpr int kLine = 16;  // floats
  for (int64_t i = 0; i < floats; i += kLine) static_cast<void>(*const_cast<const volatile float*>(begin + i));
}

}  // namespace craftfleet::CRAFTFLEET_SIMD
