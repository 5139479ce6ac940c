#include "common/agent/initial_weights.h"

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

}  // namespace

std::vector<float> InitialWeights(const AgentSpec& spec, uint64_t seed) {
  std::vector<float> weights(spec.param_count, 0.0F);
  for (const ParamSpec& param : spec.params) {
    if (param.gain == 0) continue;
    const int64_t outputs = param.shape[0];
    const int64_t inputs = param.size / outputs;
    const bool wide = outputs <= inputs;
    std::vector<double> matrix = Normals(seed, Fnv1a64(param.name), param.size);
    OrthonormaliseRows(wide ? outputs : inputs, wide ? inputs : outputs, &matrix);
    float* weight = weights.data() + param.offset;
    for (int64_t out = 0; out < outputs; ++out) {
      for (int64_t in = 0; in < inputs; ++in) {
        const double value = wide ? matrix[out * inputs + in] : matrix[in * outputs + out];
        weight[out * inputs + in] = static_cast<float>(param.gain * value);
      }
    }
  }
  return weights;
}

}  // namespace craftfleet
