#include "envserver/render/vignette.h"

#include <cmath>

namespace craftfleet {
namespace {

// The unevaluated sum of two doubles, |low| at most half a unit of high's last place: about 106 bits.
struct DoubleDouble {
  double high = 0;
  double low = 0;
};

DoubleDouble QuickSum(double large, double small) {
  const double sum = large + small;
  return {sum, small - (sum - large)};
}

DoubleDouble Product(DoubleDouble a, DoubleDouble b) {
  const double high = a.high * b.high;
  // std::fma is exact with and without hardware for it.
  const double low = std::fma(a.high, b.high, -high) + (a.high * b.low + a.low * b.high);
  return QuickSum(high, low);
}

DoubleDouble Quotient(DoubleDouble a, double b) {
  const double high = a.high / b;
  const double low = (std::fma(-high, b, a.high) + a.low) / b;
  return QuickSum(high, low);
}

// 1 + a for |a| < 1.
DoubleDouble OnePlus(DoubleDouble a) {
  const DoubleDouble sum = QuickSum(1.0, a.high);
  return QuickSum(sum.high, sum.low + a.low);
}

std::vector<double> Linspace(int count) {
  std::vector<double> values(count);
  const double step = 2.0 / (count - 1);
  for (int i = 0; i < count; ++i) values[i] = i * step + -1.0;
  values.back() = 1.0;
  return values;
}

}  // namespace

double ExpOfMinus(double x) {
  constexpr int kHalvings = 10;
  constexpr int kTerms = 11;
  const DoubleDouble small = {std::ldexp(-x, -kHalvings), 0};
  DoubleDouble result = {1.0, 0};
  // Taylor's series by Horner: below 4 / 2^10 the twelfth term is under 2^-120.
  for (int n = kTerms; n >= 1; --n) result = OnePlus(Quotient(Product(small, result), n));
  for (int i = 0; i < kHalvings; ++i) result = Product(result, result);
  return result.high;
}

std::vector<double> Vignette(int width, int height) {
  const std::vector<double> xs = Linspace(width);
  const std::vector<double> ys = Linspace(height);
  std::vector<double> cover;
  cover.reserve(static_cast<size_t>(width) * height);
  for (const double x : xs) {
    for (const double y : ys) cover.push_back(1 - ExpOfMinus(0.5 * (x * x + y * y) / 0.25));
  }
  return cover;
}

}  // namespace craftfleet
