#include "common/agent/nets/wide_product.h"

#include <algorithm>
#include <cstring>
#include <vector>

#include "common/agent/pooled_buffer.h"

namespace craftfleet {
namespace {

constexpr int64_t kInputsAtOnce = 512;    // inputs that Forward takes at once: 128 KB for 64 rows
constexpr int64_t kMinWeights = 1 << 24;  // below, the weight stays in a cache

// Pointers to `count` rows that are `step` floats apart.
template <typename Float>
std::vector<Float*> Pointers(int64_t count, Float* first, int64_t step) {
  std::vector<Float*> rows(count);
  for (int64_t i = 0; i < count; ++i) rows[i] = first + i * step;
  return rows;
}

// packed[i][64] = from[i step ..]. Rows a power of two apart would take each other's place in the cache.
void Pack(int64_t count, const float* from, int64_t step, float* packed) {
  for (int64_t i = 0; i < count; ++i)
    std::memcpy(packed + i * WideProduct::kColumns, from + i * step, WideProduct::kColumns * sizeof(float));
}

// to[k][i], rows `to_step` apart, = from[i][k], rows `from_step` apart, for i < count and k < depth.
void Transpose(int64_t count, int64_t depth, const float* from, int64_t from_step, float* to, int64_t to_step) {
  for (int64_t i = 0; i < count; ++i) {
    for (int64_t k = 0; k < depth; ++k) to[k * to_step + i] = from[i * from_step + k];
  }
}

}  // namespace

bool WideProduct::Fits(int64_t inputs, int64_t outputs) {
  return inputs * outputs >= kMinWeights && inputs % kColumns == 0 && FindDirectKernels(CurrentCpuPath()) != nullptr;
}

void WideProduct::Forward(int64_t rows, const float* input, const float* weight, float* output) const {
  const int64_t panels = (rows + kColumns - 1) / kColumns;
  const int64_t width = panels * kColumns;
  const PooledBuffer transposed(kInputsAtOnce *
                                width);       // [panels][kInputsAtOnce][64]; what lies behind the last row is padding
  const PooledBuffer sums(outputs_ * width);  // [outputs][width]
  std::memset(transposed.get(), 0, kInputsAtOnce * width * sizeof(float));
  for (int64_t k = 0; k < inputs_; k += kInputsAtOnce) {
    const int64_t depth = std::min(kInputsAtOnce, inputs_ - k);
    const auto weights = Pointers(outputs_, weight + k, inputs_);
    for (int64_t panel = 0; panel < panels; ++panel) {
      const int64_t first = panel * kColumns;
      float* const columns = transposed.get() + first * kInputsAtOnce;
      Transpose(std::min(kColumns, rows - first), depth, input + first * inputs_ + k, inputs_, columns, kColumns);
      kernels_.multiply(outputs_, weights.data(), {1, depth, 0}, columns, /*adds=*/k > 0,
                        Pointers(outputs_, sums.get() + first, width).data());
    }
  }
  Transpose(outputs_, rows, sums.get(), width, output, outputs_);
}

void WideProduct::InputGradient(int64_t rows, const float* output_gradient, const float* weight,
                                float* input_gradient) const {
  const PooledBuffer packed(outputs_ * kColumns);
  const PooledBuffer transposed(outputs_ * rows);
  Transpose(rows, outputs_, output_gradient, outputs_, transposed.get(), rows);
  const auto factors = Pointers<const float>(outputs_, transposed.get(), rows);
  for (int64_t k = 0; k < inputs_; k += kColumns) {
    Pack(outputs_, weight + k, inputs_, packed.get());
    kernels_.correlate(outputs_, factors.data(), rows, packed.get(), kColumns, /*adds=*/false, input_gradient + k,
                       inputs_);
  }
}

void WideProduct::WeightGradient(absl::Span<const Rows> shards, int64_t begin, int64_t end,
                                 absl::Span<float* const> parts) const {
  const int64_t part_outputs = outputs_ / static_cast<int64_t>(parts.size());
  std::vector<std::vector<const float*>> factors;  // of each shard, for each part
  int64_t most = 0;
  for (const Rows& shard : shards) {
    for (size_t part = 0; part < parts.size(); ++part) {
      factors.push_back(Pointers(shard.count, shard.output_gradient + part * part_outputs, outputs_));
    }
    most = std::max(most, shard.count);
  }
  const PooledBuffer packed(most * kColumns);
  for (int64_t k = begin; k < end; k += kColumns) {
    for (size_t i = 0; i < shards.size(); ++i) {
      const Rows& shard = shards[i];
      Pack(shard.count, shard.input + k, inputs_, packed.get());
      for (size_t part = 0; part < parts.size(); ++part) {
        kernels_.correlate(shard.count, factors[i * parts.size() + part].data(), part_outputs, packed.get(), kColumns,
                           /*adds=*/i > 0, parts[part] + k, inputs_);
      }
    }
  }
}

}  // namespace craftfleet
