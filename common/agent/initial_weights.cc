#include "common/agent/initial_weights.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>

#include <absl/strings/string_view.h>
#include <absl/types/span.h>

#include "common/keyed_random.h"

namespace craftfleet {
namespace {

uint64_t Fnv1a64(absl::string_view text) {
  uint64_t hash = 0xCBF29CE484222325ULL;
  for (const char c : text) hash = (hash ^ static_cast<unsigned char>(c)) * 0x100000001B3ULL;
  return hash;
}

// `count` independent N(0, 1) by Box and Muller.
std::vector<double> Normals(uint64_t seed, uint64_t stream, int64_t count) {
  constexpr double kTwoPi = 6.283185307179586;
  std::vector<double> normals(count);
  for (int64_t i = 0; i < count; i += 2) {
    const auto uniform = [&](int64_t k) {
      return UnitInterval(KeyedBits(RandomUse::kInitialWeights, seed, stream, static_cast<uint64_t>(k)));
    };
    const double radius = std::sqrt(-2 * std::log(1 - uniform(i)));
    const double angle = kTwoPi * uniform(i + 1);
    normals[i] = radius * std::cos(angle);
    if (i + 1 < count) normals[i + 1] = radius * std::sin(angle);
  }
  return normals;
}

double Dot(absl::Span<const double> a, absl::Span<const double> b) {
  // Independent sums, so that the compiler may use vectors without reordering any of them.
  std::array<double, 8> sums{};
  size_t i = 0;
  for (; i + sums.size() <= a.size(); i += sums.size()) {
    for (size_t k = 0; k < sums.size(); ++k) sums[k] += a[i + k] * b[i + k];
  }
  double rest = 0;
  for (; i < a.size(); ++i) rest += a[i] * b[i];
  for (const double sum : sums) rest += sum;
  return rest;
}

// Modified Gram-Schmidt over the `count` rows of `length` >= `count`. From normal numbers it gives the uniform
// distribution, as QR with a positive diagonal of R does.
void OrthonormaliseRows(int64_t count, int64_t length, std::vector<double>* matrix) {
  const auto row = [&](int64_t i) { return absl::MakeSpan(matrix->data() + i * length, length); };
  for (int64_t i = 0; i < count; ++i) {
    const absl::Span<double> unit = row(i);
    const double norm = std::sqrt(Dot(unit, unit));
    for (double& x : unit) x /= norm;
    for (int64_t j = i + 1; j < count; ++j) {
      const absl::Span<double> other = row(j);
      const double projection = Dot(unit, other);
      for (int64_t k = 0; k < length; ++k) other[k] -= projection * unit[k];
    }
  }
}

// The numbers of `param`, an orthogonal matrix.
void FillOrthogonal(const ParamSpec& param, uint64_t seed, float* weight) {
  const int64_t outputs = param.shape[0];
  const int64_t inputs = param.size / outputs;
  const bool wide = outputs <= inputs;
  std::vector<double> matrix = Normals(seed, Fnv1a64(param.name), param.size);
  OrthonormaliseRows(wide ? outputs : inputs, wide ? inputs : outputs, &matrix);
  for (int64_t out = 0; out < outputs; ++out) {
    for (int64_t in = 0; in < inputs; ++in) {
      const double value = wide ? matrix[out * inputs + in] : matrix[in * outputs + out];
      weight[out * inputs + in] = static_cast<float>(param.init.scale * value);
    }
  }
}

// U(-1, 1).
double SignedUniform(const ParamSpec& param, uint64_t seed, int64_t i) {
  const uint64_t stream = Fnv1a64(param.name);
  return 2 * UnitInterval(KeyedBits(RandomUse::kInitialWeights, seed, stream, static_cast<uint64_t>(i))) - 1;
}

void FillRowNorm(const ParamSpec& param, uint64_t seed, float* weight) {
  const int64_t columns = param.size / param.shape[0];
  std::vector<double> row(columns);
  for (int64_t first = 0; first < param.size; first += columns) {
    for (int64_t k = 0; k < columns; ++k) row[k] = SignedUniform(param, seed, first + k);
    const double scale = param.init.scale / std::sqrt(Dot(row, row));
    for (int64_t k = 0; k < columns; ++k) weight[first + k] = static_cast<float>(scale * row[k]);
  }
}

void Fill(const ParamSpec& param, uint64_t seed, float* weight) {
  const double scale = param.init.scale;
  switch (param.init.kind) {
    case ParamInit::Kind::kConstant:
      std::fill_n(weight, param.size, static_cast<float>(scale));
      return;
    case ParamInit::Kind::kNormal: {
      const std::vector<double> normals = Normals(seed, Fnv1a64(param.name), param.size);
      for (int64_t i = 0; i < param.size; ++i) weight[i] = static_cast<float>(scale * normals[i]);
      return;
    }
    case ParamInit::Kind::kUniform:
      for (int64_t i = 0; i < param.size; ++i) weight[i] = static_cast<float>(scale * SignedUniform(param, seed, i));
      return;
    case ParamInit::Kind::kOrthogonal:
      return FillOrthogonal(param, seed, weight);
    case ParamInit::Kind::kRowNorm:
      return FillRowNorm(param, seed, weight);
  }
}

}  // namespace

std::vector<float> InitialWeights(const AgentSpec& spec, uint64_t seed) {
  std::vector<float> weights(spec.param_count);
  for (const ParamSpec& param : spec.params) Fill(param, seed, weights.data() + param.offset);
  return weights;
}

}  // namespace craftfleet
