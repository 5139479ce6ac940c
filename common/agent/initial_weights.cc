#include "common/agent/initial_weights.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <functional>

#include <absl/strings/string_view.h>
#include <absl/types/span.h>

#include "common/base/fnv1a.h"
#include "common/base/keyed_random.h"
#include "common/base/multiversion.h"

namespace craftfleet {
namespace {

// Calls part(i) for each i of 0..count-1, on the workers if there are any. No result depends on their number.
void RunParts(WorkerPool* workers, int64_t count, const std::function<void(int)>& part) {
  if (workers != nullptr) {
    workers->Run(static_cast<int>(count), part);
    return;
  }
  for (int i = 0; i < count; ++i) part(i);
}

// `count` independent N(0, 1) by Box and Muller.
std::vector<double> Normals(uint64_t seed, uint64_t stream, int64_t count, WorkerPool* workers) {
  constexpr double kTwoPi = 6.283185307179586;
  constexpr int64_t kPart = 1 << 16;
  std::vector<double> normals(count);
  RunParts(workers, (count + kPart - 1) / kPart, [&](int part) {
    const int64_t end = std::min(count, (part + 1) * kPart);
    for (int64_t i = part * kPart; i < end; i += 2) {
      const auto uniform = [&](int64_t k) {
        return UnitInterval(KeyedBits(RandomUse::kInitialWeights, seed, stream, static_cast<uint64_t>(k)));
      };
      const double radius = std::sqrt(-2 * std::log(1 - uniform(i)));
      const double angle = kTwoPi * uniform(i + 1);
      normals[i] = radius * std::cos(angle);
      if (i + 1 < count) normals[i + 1] = radius * std::sin(angle);
    }
  });
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

// out[0..n) += factors[m * factor_stride] * rows[m * stride + 0..n), over m in 0..count.
CRAFTFLEET_MULTIVERSION
void AddMultiples(const double* factors, int64_t factor_stride, const double* rows, int64_t stride, int64_t count,
                  int64_t n, double* out) {
  constexpr int64_t kAtOnce = 8;  // rows, so that `out` is read and written less often
  int64_t m = 0;
  for (; m + kAtOnce <= count; m += kAtOnce) {
    const double* f = factors + m * factor_stride;
    const double* r = rows + m * stride;
    const int64_t s = stride;
    const double f0 = f[0], f1 = f[factor_stride], f2 = f[2 * factor_stride], f3 = f[3 * factor_stride];
    const double f4 = f[4 * factor_stride], f5 = f[5 * factor_stride], f6 = f[6 * factor_stride],
                 f7 = f[7 * factor_stride];
    for (int64_t k = 0; k < n; ++k) {
      out[k] += ((f0 * r[k] + f1 * r[s + k]) + (f2 * r[2 * s + k] + f3 * r[3 * s + k])) +
                ((f4 * r[4 * s + k] + f5 * r[5 * s + k]) + (f6 * r[6 * s + k] + f7 * r[7 * s + k]));
    }
  }
  for (; m < count; ++m) {
    const double f = factors[m * factor_stride];
    for (int64_t k = 0; k < n; ++k) out[k] += f * rows[m * stride + k];
  }
}

constexpr int64_t kChunk = 128;  // columns at a time, so that those of all rows stay in the cache

// The lower triangle of matrix * matrix^T, [count,count].
std::vector<double> GramMatrix(int64_t count, int64_t length, const std::vector<double>& matrix, WorkerPool* workers) {
  std::vector<double> gram(count * count, 0.0);
  // Each part computes every so many rows of the result, since later ones are longer.
  const int64_t parts = workers == nullptr ? 1 : std::min<int64_t>(count, 2 * workers->threads());
  RunParts(workers, parts, [&](int part) {
    std::vector<double> columns(kChunk * count);  // [kChunk,count]
    for (int64_t first = 0; first < length; first += kChunk) {
      const int64_t width = std::min(kChunk, length - first);
      for (int64_t i = 0; i < count; ++i) {
        for (int64_t k = 0; k < width; ++k) columns[k * count + i] = matrix[i * length + first + k];
      }
      for (int64_t i = part; i < count; i += parts) {
        AddMultiples(&columns[i], count, columns.data(), count, width, i + 1, &gram[i * count]);
      }
    }
  });
  return gram;
}

// Cholesky's decomposition in place: the lower triangle of a positive definite matrix becomes L of L * L^T.
void Decompose(int64_t count, std::vector<double>* matrix) {
  double* l = matrix->data();
  for (int64_t i = 0; i < count; ++i) {
    double* row = l + i * count;
    for (int64_t j = 0; j <= i; ++j) {
      const double* other = l + j * count;
      const double rest = row[j] - Dot({row, static_cast<size_t>(j)}, {other, static_cast<size_t>(j)});
      row[j] = i == j ? std::sqrt(rest) : rest / other[j];
    }
  }
}

// Makes the `count` rows of `length` >= `count` orthonormal: the inverse of their Gram matrix' Cholesky factor times
// the matrix, the result of Gram-Schmidt, but in blocks. From normal numbers it is the uniform distribution, as
// QR with a positive diagonal of R.
void OrthonormaliseRows(int64_t count, int64_t length, std::vector<double>* matrix, WorkerPool* workers) {
  std::vector<double> factor = GramMatrix(count, length, *matrix, workers);
  Decompose(count, &factor);
  for (double& x : factor) x = -x;
  RunParts(workers, (length + kChunk - 1) / kChunk, [&](int part) {
    const int64_t first = part * kChunk;
    const int64_t width = std::min(kChunk, length - first);
    std::vector<double> chunk(count * kChunk);  // [count,kChunk]
    for (int64_t i = 0; i < count; ++i) {
      double* row = &chunk[i * kChunk];
      double* place = matrix->data() + i * length + first;
      std::copy_n(place, width, row);
      AddMultiples(&factor[i * count], 1, chunk.data(), kChunk, i, width, row);
      for (int64_t k = 0; k < width; ++k) row[k] /= -factor[i * count + i];
      std::copy_n(row, width, place);
    }
  });
}

// The numbers of `param`, an orthogonal matrix.
void FillOrthogonal(const ParamSpec& param, uint64_t seed, WorkerPool* workers, float* weight) {
  const int64_t outputs = param.shape[0];
  const int64_t inputs = param.size / outputs;
  const bool wide = outputs <= inputs;
  std::vector<double> matrix = Normals(seed, Fnv1a(kFnv1aBasis, param.name), param.size, workers);
  const int64_t count = wide ? outputs : inputs;
  const int64_t length = wide ? inputs : outputs;
  OrthonormaliseRows(count, length, &matrix, workers);
  // A matrix that is nearly square is ill-conditioned and needs a second time.
  if (length < 4 * count) OrthonormaliseRows(count, length, &matrix, workers);
  RunParts(workers, outputs, [&](int64_t out) {
    for (int64_t in = 0; in < inputs; ++in) {
      const double value = wide ? matrix[out * inputs + in] : matrix[in * outputs + out];
      weight[out * inputs + in] = static_cast<float>(param.init.scale * value);
    }
  });
}

// U(-1, 1).
double SignedUniform(const ParamSpec& param, uint64_t seed, int64_t i) {
  const uint64_t stream = Fnv1a(kFnv1aBasis, param.name);
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

void Fill(const ParamSpec& param, uint64_t seed, WorkerPool* workers, float* weight) {
  const double scale = param.init.scale;
  switch (param.init.kind) {
    case ParamInit::Kind::kConstant:
      std::fill_n(weight, param.size, static_cast<float>(scale));
      return;
    case ParamInit::Kind::kNormal: {
      const std::vector<double> normals = Normals(seed, Fnv1a(kFnv1aBasis, param.name), param.size, workers);
      for (int64_t i = 0; i < param.size; ++i) weight[i] = static_cast<float>(scale * normals[i]);
      return;
    }
    case ParamInit::Kind::kUniform:
      for (int64_t i = 0; i < param.size; ++i) weight[i] = static_cast<float>(scale * SignedUniform(param, seed, i));
      return;
    case ParamInit::Kind::kOrthogonal:
      return FillOrthogonal(param, seed, workers, weight);
    case ParamInit::Kind::kRowNorm:
      return FillRowNorm(param, seed, weight);
  }
}

}  // namespace

std::vector<float> InitialWeights(const AgentSpec& spec, uint64_t seed, WorkerPool* workers) {
  std::vector<float> weights(spec.param_count);
  for (const ParamSpec& param : spec.params) Fill(param, seed, workers, weights.data() + param.offset);
  return weights;
}

}  // namespace craftfleet
