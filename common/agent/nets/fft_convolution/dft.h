// Discrete Fourier transforms of a few points, X[k] = sum over n of x[n] exp(-2 pi i n k / points), for vectors of
// independent numbers. Real and imaginary parts are apart. The inverse, without its division by the number of points,
// is the same transform with the parts exchanged on both sides: conj(X) = i swap(X).

#pragma once

#include "common/agent/nets/simd.h"

namespace craftfleet::CRAFTFLEET_SIMD {

// Sine and cosine for the compiler: |x| <= pi.
constexpr double SineSeries(double x, int first) {
  double term = first == 0 ? 1 : x;
  double sum = term;
  for (int i = first + 2; i < 42; i += 2) {
    term *= -x * x / (i * (i - 1.0));
    sum += term;
  }
  return sum;
}

// cos[k] and sin[k] of 2 pi k / Points.
template <int Points>
struct Circle {
  float cos[Points] = {};
  float sin[Points] = {};

  constexpr Circle() {
    constexpr double kPi = 3.14159265358979323846;
    for (int k = 0; k < Points; ++k) {
      const double angle = 2 * kPi * (2 * k > Points ? k - Points : k) / Points;
      cos[k] = static_cast<float>(SineSeries(angle, 0));
      sin[k] = static_cast<float>(SineSeries(angle, 1));
    }
  }
};
template <int Points>
constexpr Circle<Points> kCircle;

// Four points, in place.
CRAFTFLEET_SIMD_INLINE void Dft4(Vector* re, Vector* im) {
  const Vector even_re = re[0] + re[2], even_im = im[0] + im[2], odd_re = re[1] + re[3], odd_im = im[1] + im[3];
  const Vector across_re = re[0] - re[2], across_im = im[0] - im[2];
  const Vector turned_re = im[1] - im[3], turned_im = re[3] - re[1];  // -i (x[1] - x[3])
  re[0] = even_re + odd_re, im[0] = even_im + odd_im;
  re[1] = across_re + turned_re, im[1] = across_im + turned_im;
  re[2] = even_re - odd_re, im[2] = even_im - odd_im;
  re[3] = across_re - turned_re, im[3] = across_im - turned_im;
}

// Three points that lie `stride` vectors apart, from x to y.
CRAFTFLEET_SIMD_INLINE void Dft3(const Vector* x_re, const Vector* x_im, int x_stride, Vector* y_re, Vector* y_im,
                                 int y_stride) {
  const Vector half = Broadcast(0.5F), sine = Broadcast(kCircle<3>.sin[1]);
  const Vector sum_re = x_re[x_stride] + x_re[2 * x_stride], sum_im = x_im[x_stride] + x_im[2 * x_stride];
  const Vector difference_re = x_re[x_stride] - x_re[2 * x_stride];
  const Vector difference_im = x_im[x_stride] - x_im[2 * x_stride];
  const Vector middle_re = NegMulAdd(half, sum_re, x_re[0]), middle_im = NegMulAdd(half, sum_im, x_im[0]);
  y_re[0] = x_re[0] + sum_re, y_im[0] = x_im[0] + sum_im;
  y_re[y_stride] = MulAdd(sine, difference_im, middle_re);
  y_im[y_stride] = NegMulAdd(sine, difference_re, middle_im);
  y_re[2 * y_stride] = NegMulAdd(sine, difference_im, middle_re);
  y_im[2 * y_stride] = MulAdd(sine, difference_re, middle_im);
}

// x *= cos - i sin.
CRAFTFLEET_SIMD_INLINE void Turn(float cos, float sin, Vector* re, Vector* im) {
  const Vector c = Broadcast(cos), s = Broadcast(sin);
  const Vector from_im = *im * s, from_re = *re * s;
  *re = MulAdd(*re, c, from_im);
  *im = MulAdd(*im, c, -from_re);
}

// An odd prime number of points, by its definition with n and Points - n taken together.
template <int Points>
struct Dft {
  static constexpr int kHalf = (Points - 1) / 2;

  // Complex to complex: [Points] each.
  static CRAFTFLEET_SIMD_INLINE void Complex(const Vector* x_re, const Vector* x_im, Vector* y_re, Vector* y_im) {
    Vector sum_re[kHalf], sum_im[kHalf], difference_re[kHalf], difference_im[kHalf];
    y_re[0] = x_re[0], y_im[0] = x_im[0];
    CRAFTFLEET_UNROLL
    for (int n = 0; n < kHalf; ++n) {
      sum_re[n] = x_re[n + 1] + x_re[Points - 1 - n], sum_im[n] = x_im[n + 1] + x_im[Points - 1 - n];
      difference_re[n] = x_re[n + 1] - x_re[Points - 1 - n], difference_im[n] = x_im[n + 1] - x_im[Points - 1 - n];
      y_re[0] = y_re[0] + sum_re[n], y_im[0] = y_im[0] + sum_im[n];
    }
    CRAFTFLEET_UNROLL
    for (int k = 1; k <= kHalf; ++k) {
      Vector even_re = x_re[0], even_im = x_im[0], odd_re = Zero(), odd_im = Zero();
      CRAFTFLEET_UNROLL
      for (int n = 0; n < kHalf; ++n) {
        const Vector c = Broadcast(kCircle<Points>.cos[(n + 1) * k % Points]);
        const Vector s = Broadcast(kCircle<Points>.sin[(n + 1) * k % Points]);
        even_re = MulAdd(c, sum_re[n], even_re), even_im = MulAdd(c, sum_im[n], even_im);
        odd_re = MulAdd(s, difference_re[n], odd_re), odd_im = MulAdd(s, difference_im[n], odd_im);
      }
      y_re[k] = even_re + odd_im, y_im[k] = even_im - odd_re;
      y_re[Points - k] = even_re - odd_im, y_im[Points - k] = even_im + odd_re;
    }
  }

  // Real to the frequencies 0..kHalf; im[0], which is 0, is not written.
  static CRAFTFLEET_SIMD_INLINE void Real(const Vector* x, Vector* re, Vector* im) {
    Vector sum[kHalf], difference[kHalf];
    re[0] = x[0];
    CRAFTFLEET_UNROLL
    for (int n = 0; n < kHalf; ++n) {
      sum[n] = x[n + 1] + x[Points - 1 - n], difference[n] = x[n + 1] - x[Points - 1 - n];
      re[0] = re[0] + sum[n];
    }
    CRAFTFLEET_UNROLL
    for (int k = 1; k <= kHalf; ++k) {
      re[k] = x[0], im[k] = Zero();
      CRAFTFLEET_UNROLL
      for (int n = 0; n < kHalf; ++n) {
        re[k] = MulAdd(Broadcast(kCircle<Points>.cos[(n + 1) * k % Points]), sum[n], re[k]);
        im[k] = NegMulAdd(Broadcast(kCircle<Points>.sin[(n + 1) * k % Points]), difference[n], im[k]);
      }
    }
  }

  // The inverse of Real, times Points.
  static CRAFTFLEET_SIMD_INLINE void RealInverse(const Vector* re, const Vector* im, Vector* x) {
    Vector sum = re[1];
    CRAFTFLEET_UNROLL
    for (int k = 2; k <= kHalf; ++k) sum = sum + re[k];
    x[0] = MulAdd(Broadcast(2), sum, re[0]);
    CRAFTFLEET_UNROLL
    for (int n = 1; n <= kHalf; ++n) {
      Vector even = re[0], odd = Zero();
      CRAFTFLEET_UNROLL
      for (int k = 1; k <= kHalf; ++k) {
        even = MulAdd(Broadcast(2 * kCircle<Points>.cos[n * k % Points]), re[k], even);
        odd = MulAdd(Broadcast(2 * kCircle<Points>.sin[n * k % Points]), im[k], odd);
      }
      x[n] = even - odd, x[Points - n] = even + odd;
    }
  }
};

// Nine points as three times three: n = n0 + 3 n1, k = 3 k0 + k1, with factors exp(-2 pi i n0 k1 / 9) between.
template <>
struct Dft<9> {
  static constexpr int kHalf = 4;

  static CRAFTFLEET_SIMD_INLINE void Complex(const Vector* x_re, const Vector* x_im, Vector* y_re, Vector* y_im) {
    Vector re[9], im[9];  // [n0][k1]
    CRAFTFLEET_UNROLL
    for (int n = 0; n < 3; ++n) Dft3(x_re + n, x_im + n, 3, re + 3 * n, im + 3 * n, 1);
    CRAFTFLEET_UNROLL
    for (int n = 1; n < 3; ++n) {
      CRAFTFLEET_UNROLL
      for (int k = 1; k < 3; ++k) {
        Turn(kCircle<9>.cos[n * k], kCircle<9>.sin[n * k], &re[3 * n + k], &im[3 * n + k]);
      }
    }
    CRAFTFLEET_UNROLL
    for (int k = 0; k < 3; ++k) Dft3(re + k, im + k, 3, y_re + k, y_im + k, 3);
  }

  static CRAFTFLEET_SIMD_INLINE void Real(const Vector* x, Vector* re, Vector* im) {
    const Vector half = Broadcast(0.5F), minus_sine = Broadcast(-kCircle<3>.sin[1]);
    Vector sums[3];                     // [n0], k1 = 0: real
    Vector turned_re[3], turned_im[3];  // [n0], k1 = 1; k1 = 2 is its conjugate
    CRAFTFLEET_UNROLL
    for (int n = 0; n < 3; ++n) {
      const Vector sum = x[n + 3] + x[n + 6];
      sums[n] = x[n] + sum;
      turned_re[n] = NegMulAdd(half, sum, x[n]);
      turned_im[n] = minus_sine * (x[n + 3] - x[n + 6]);
    }
    const Vector sum = sums[1] + sums[2];
    re[0] = sums[0] + sum;
    re[3] = NegMulAdd(half, sum, sums[0]);
    im[3] = minus_sine * (sums[1] - sums[2]);
    Turn(kCircle<9>.cos[1], kCircle<9>.sin[1], &turned_re[1], &turned_im[1]);
    Turn(kCircle<9>.cos[2], kCircle<9>.sin[2], &turned_re[2], &turned_im[2]);
    Vector y_re[3], y_im[3];  // frequencies 1, 4 and 7
    Dft3(turned_re, turned_im, 1, y_re, y_im, 1);
    re[1] = y_re[0], im[1] = y_im[0];
    re[4] = y_re[1], im[4] = y_im[1];
    re[2] = y_re[2], im[2] = -y_im[2];  // the conjugate of frequency 7
  }

  static CRAFTFLEET_SIMD_INLINE void RealInverse(const Vector* re, const Vector* im, Vector* x) {
    const Vector two = Broadcast(2), twice_sine = Broadcast(2 * kCircle<3>.sin[1]);
    const Vector middle = re[0] - re[3];
    const Vector sums[3] = {MulAdd(two, re[3], re[0]), NegMulAdd(twice_sine, im[3], middle),
                            MulAdd(twice_sine, im[3], middle)};
    const Vector y_re[3] = {re[1], re[4], re[2]}, y_im[3] = {im[1], im[4], -im[2]};
    Vector turned_re[3], turned_im[3];
    Dft3(y_im, y_re, 1, turned_im, turned_re, 1);
    Turn(kCircle<9>.cos[1], -kCircle<9>.sin[1], &turned_re[1], &turned_im[1]);
    Turn(kCircle<9>.cos[2], -kCircle<9>.sin[2], &turned_re[2], &turned_im[2]);
    CRAFTFLEET_UNROLL
    for (int n = 0; n < 3; ++n) {
      const Vector rest = sums[n] - turned_re[n];
      x[n] = MulAdd(two, turned_re[n], sums[n]);
      x[n + 3] = NegMulAdd(twice_sine, turned_im[n], rest);
      x[n + 6] = MulAdd(twice_sine, turned_im[n], rest);
    }
  }
};

}  // namespace craftfleet::CRAFTFLEET_SIMD
