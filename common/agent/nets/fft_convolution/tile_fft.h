// The transform of a tile: a square of N = 4 Q real points a side, for vectors of channels side by side.
//
// By the prime-factor algorithm a transform of N points is one of 4 by Q without factors between: n = (Q n0 + 4 n1)
// mod N and k0 = k mod 4, k1 = k mod Q give exp(-2 pi i n k / N) = exp(-2 pi i n0 k0 / 4) exp(-2 pi i n1 k1 / Q).
// Products of spectra do not ask for the order of frequencies, so they stay where (k0, k1) leaves them.
//
// Rows first, real to half a spectrum: 2 Q complex columns, of which the first holds two real ones, frequencies 0 and
// N / 2, as real and imaginary part. Then columns: N frequencies each; of the two real columns half, 2 Q + 1 each.
// Together 8 Q^2 + 2 frequencies.

#pragma once

#include "common/agent/nets/fft_convolution/dft.h"
#include "common/agent/nets/simd.h"

namespace craftfleet::CRAFTFLEET_SIMD {

template <int Q>
struct TileFft {
  static constexpr int kPoints = 4 * Q;  // a side
  static constexpr int kColumns = 2 * Q;
  static constexpr int kHalfColumn = 2 * Q + 1;  // frequencies of a real column
  static constexpr int kFrequencies = 2 * kHalfColumn + (kColumns - 1) * kPoints;
  // Floats of one row after its transform: [column][re, im][kWidth]. A tile between rows and columns is
  // [kPoints][kRowFloats].
  static constexpr int kRowFloats = kColumns * 2 * kWidth;
  static constexpr int kRowsFloats = kPoints * kRowFloats;
  // Floats of one column's spectrum: [frequency][re, im][kWidth].
  static constexpr int kColumnFloats = kPoints * 2 * kWidth;

  // load(n): point n of the row. `row`: [kRowFloats].
  template <typename LoadPoint>
  static CRAFTFLEET_SIMD_INLINE void Row(const LoadPoint& load, float* row) {
    Vector even[Q], odd[Q], side_re[Q], side_im[Q];  // k0 = 0, 2 and 1; k0 = 3 is the conjugate of 1
    CRAFTFLEET_UNROLL
    for (int n = 0; n < Q; ++n) {
      const Vector x0 = load(4 * n % kPoints), x1 = load((Q + 4 * n) % kPoints);
      const Vector x2 = load((2 * Q + 4 * n) % kPoints), x3 = load((3 * Q + 4 * n) % kPoints);
      even[n] = (x0 + x2) + (x1 + x3), odd[n] = (x0 + x2) - (x1 + x3);
      side_re[n] = x0 - x2, side_im[n] = x3 - x1;
    }
    RowHalf(even, row, kEven);
    RowHalf(odd, row, kOdd);
    Vector re[Q], im[Q];
    Dft<Q>::Complex(side_re, side_im, re, im);
    CRAFTFLEET_UNROLL
    for (int k = 0; k < Q; ++k) StorePair(row, kSide + k, re[k], im[k]);
  }

  // The inverse of Row, times kPoints: store(n, point n).
  template <typename StorePoint>
  static CRAFTFLEET_SIMD_INLINE void RowInverse(const float* row, const StorePoint& store) {
    Vector even[Q], odd[Q], side_re[Q], side_im[Q];
    RowHalfInverse(row, kEven, even);
    RowHalfInverse(row, kOdd, odd);
    Vector re[Q], im[Q];
    CRAFTFLEET_UNROLL
    for (int k = 0; k < Q; ++k) LoadPair(row, kSide + k, &re[k], &im[k]);
    Dft<Q>::Complex(im, re, side_im, side_re);
    const Vector two = Broadcast(2);
    CRAFTFLEET_UNROLL
    for (int n = 0; n < Q; ++n) {
      const Vector sum = even[n] + odd[n], difference = even[n] - odd[n];
      store(4 * n % kPoints, MulAdd(two, side_re[n], sum));
      store((2 * Q + 4 * n) % kPoints, NegMulAdd(two, side_re[n], sum));
      store((Q + 4 * n) % kPoints, NegMulAdd(two, side_im[n], difference));
      store((3 * Q + 4 * n) % kPoints, MulAdd(two, side_im[n], difference));
    }
  }

  // The spectrum of complex column `c` of the transformed rows, frequency (k0, k1) at k0 Q + k1.
  // `spectrum`: [kColumnFloats].
  static CRAFTFLEET_SIMD_INLINE void Column(const float* rows, int c, float* spectrum) {
    alignas(64) float quarters[kColumnFloats];  // [k0][n1]
    CRAFTFLEET_UNROLL
    for (int n1 = 0; n1 < Q; ++n1) {
      Vector re[4], im[4];
      CRAFTFLEET_UNROLL
      for (int n0 = 0; n0 < 4; ++n0) LoadPair(rows + (Q * n0 + 4 * n1) % kPoints * kRowFloats, c, &re[n0], &im[n0]);
      Dft4(re, im);
      CRAFTFLEET_UNROLL
      for (int k0 = 0; k0 < 4; ++k0) StorePair(quarters, k0 * Q + n1, re[k0], im[k0]);
    }
    for (int k0 = 0; k0 < 4; ++k0) {
      Vector x_re[Q], x_im[Q], y_re[Q], y_im[Q];
      CRAFTFLEET_UNROLL
      for (int n1 = 0; n1 < Q; ++n1) LoadPair(quarters, k0 * Q + n1, &x_re[n1], &x_im[n1]);
      Dft<Q>::Complex(x_re, x_im, y_re, y_im);
      CRAFTFLEET_UNROLL
      for (int k1 = 0; k1 < Q; ++k1) StorePair(spectrum, k0 * Q + k1, y_re[k1], y_im[k1]);
    }
  }

  // The inverse of Column, times kPoints.
  static CRAFTFLEET_SIMD_INLINE void ColumnInverse(const float* spectrum, int c, float* rows) {
    alignas(64) float quarters[kColumnFloats];
    for (int k0 = 0; k0 < 4; ++k0) {
      Vector x_re[Q], x_im[Q], y_re[Q], y_im[Q];
      CRAFTFLEET_UNROLL
      for (int k1 = 0; k1 < Q; ++k1) LoadPair(spectrum, k0 * Q + k1, &x_re[k1], &x_im[k1]);
      Dft<Q>::Complex(x_im, x_re, y_im, y_re);
      CRAFTFLEET_UNROLL
      for (int n1 = 0; n1 < Q; ++n1) StorePair(quarters, k0 * Q + n1, y_re[n1], y_im[n1]);
    }
    CRAFTFLEET_UNROLL
    for (int n1 = 0; n1 < Q; ++n1) {
      Vector re[4], im[4];
      CRAFTFLEET_UNROLL
      for (int k0 = 0; k0 < 4; ++k0) LoadPair(quarters, k0 * Q + n1, &re[k0], &im[k0]);
      Dft4(im, re);
      CRAFTFLEET_UNROLL
      for (int n0 = 0; n0 < 4; ++n0) StorePair(rows + (Q * n0 + 4 * n1) % kPoints * kRowFloats, c, re[n0], im[n0]);
    }
  }

  // Splits the spectrum Z of two real columns a + i b, which Column made of column 0: for each frequency of half a
  // column calls put(u, A, B) with their spectra, A[k] = (Z[k] + conj Z[-k]) / 2 and B[k] = (Z[k] - conj Z[-k]) / 2i.
  template <typename Put>
  static CRAFTFLEET_SIMD_INLINE void SplitReal(const float* spectrum, const Put& put) {
    const Vector half = Broadcast(0.5F), minus_half = Broadcast(-0.5F);
    ForHalfColumn([&](int u, int k, int minus_k) {
      Vector re, im, minus_re, minus_im;
      LoadPair(spectrum, k, &re, &im);
      LoadPair(spectrum, minus_k, &minus_re, &minus_im);
      put(u, half * (re + minus_re), half * (im - minus_im), half * (im + minus_im), minus_half * (re - minus_re));
    });
  }

  // The inverse of SplitReal: get(u, &A_re, &A_im, &B_re, &B_im).
  template <typename Get>
  static CRAFTFLEET_SIMD_INLINE void JoinReal(const Get& get, float* spectrum) {
    ForHalfColumn([&](int u, int k, int minus_k) {
      Vector a_re, a_im, b_re, b_im;
      get(u, &a_re, &a_im, &b_re, &b_im);
      if (k == minus_k) {  // A and B are real there, but for rounding
        StorePair(spectrum, k, a_re, b_re);
        return;
      }
      StorePair(spectrum, k, a_re - b_im, a_im + b_re);
      StorePair(spectrum, minus_k, a_re + b_im, b_re - a_im);
    });
  }

  static CRAFTFLEET_SIMD_INLINE void LoadPair(const float* from, int index, Vector* re, Vector* im) {
    *re = Load(from + 2 * index * kWidth);
    *im = Load(from + (2 * index + 1) * kWidth);
  }
  static CRAFTFLEET_SIMD_INLINE void StorePair(float* to, int index, Vector re, Vector im) {
    Store(to + 2 * index * kWidth, re);
    Store(to + (2 * index + 1) * kWidth, im);
  }

 private:
  static constexpr int kHalf = Dft<Q>::kHalf;
  // The first columns with k0 = 0, 2 and 1. Column 0 is the first of both kEven and kOdd.
  static constexpr int kEven = 0;
  static constexpr int kOdd = kHalf;
  static constexpr int kSide = 2 * kHalf + 1;

  static CRAFTFLEET_SIMD_INLINE void RowHalf(const Vector* x, float* row, int first) {
    Vector re[kHalf + 1], im[kHalf + 1];
    Dft<Q>::Real(x, re, im);
    Store(row + (first == kEven ? 0 : kWidth), re[0]);
    CRAFTFLEET_UNROLL
    for (int k = 1; k <= kHalf; ++k) StorePair(row, first + k, re[k], im[k]);
  }

  static CRAFTFLEET_SIMD_INLINE void RowHalfInverse(const float* row, int first, Vector* x) {
    Vector re[kHalf + 1], im[kHalf + 1];
    re[0] = Load(row + (first == kEven ? 0 : kWidth));
    CRAFTFLEET_UNROLL
    for (int k = 1; k <= kHalf; ++k) LoadPair(row, first + k, &re[k], &im[k]);
    Dft<Q>::RealInverse(re, im, x);
  }

  // Calls each(u, index of frequency k, index of frequency -k) for one of each such pair.
  template <typename Each>
  static CRAFTFLEET_SIMD_INLINE void ForHalfColumn(const Each& each) {
    each(0, 0, 0);
    each(1, 2 * Q, 2 * Q);
    for (int k = 1; k <= kHalf; ++k) {
      each(1 + k, k, Q - k);
      each(1 + kHalf + k, 2 * Q + k, 3 * Q - k);
    }
    for (int k = 0; k < Q; ++k) each(2 + 2 * kHalf + k, Q + k, 3 * Q + (Q - k) % Q);
  }
};

}  // namespace craftfleet::CRAFTFLEET_SIMD
