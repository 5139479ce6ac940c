#include "common/agent/nets/wide_product.h"

#include <algorithm>
#include <cstring>
#include <type_traits>
#include <vector>

#include "common/agent/nets/direct_convolution/kernels.h"
#include "common/agent/pooled_buffer.h"

namespace craftfleet {
namespace {

constexpr int64_t kWordsAtOnce = 512;     // of a row of inputs, that Forward takes at once: 128 KB for 64 rows
constexpr int64_t kMinWeights = 1 << 24;  // below, the weight stays in a cache

// Numbers as the words of kernels: a float, or two of bfloat16. Words are moved, never computed with.
template <typename Number>
const float* Words(const Number* numbers) {
  return reinterpret_cast<const float*>(numbers);
}

// words[i][k], rows `width` apart, = from[i][k], rows `step` apart, for i < count. Rows a power of two apart would take
// each other's place in the cache.
void Pack(int64_t count, int64_t width, const float* from, int64_t step, float* words) {
  for (int64_t i = 0; i < count; ++i) std::memcpy(words + i * width, from + i * step, width * sizeof(float));
}

// words[i / 2][k] = (from[i][k], from[i + 1][k]) for even i; behind an odd last row comes 0.
void Pack(int64_t count, int64_t width, const Bfloat16* from, int64_t step, float* words) {
  auto* const to = reinterpret_cast<Bfloat16*>(words);
  for (int64_t i = 0; i < count; i += 2) {
    const Bfloat16* const row = from + i * step;
    for (int64_t k = 0; k < width; ++k) {
      to[i * width + 2 * k] = row[k];
      to[i * width + 2 * k + 1] = i + 1 < count ? row[step + k] : 0;
    }
  }
}

// to[k][i], rows `to_step` apart, = from[i][k], rows `from_step` apart, for i < count and k < depth.
void Transpose(int64_t count, int64_t depth, const float* from, int64_t from_step, float* to, int64_t to_step) {
  for (int64_t i = 0; i < count; ++i) {
    for (int64_t k = 0; k < depth; ++k) to[k * to_step + i] = from[i * from_step + k];
  }
}

}  // namespace

template <typename Number>
const ProductKernels* WideProduct<Number>::FindKernels() {
  if constexpr (std::is_same_v<Number, float>) return FindDirectKernels(CurrentCpuPath());
  return FindBf16Kernels();
}

template <typename Number>
bool WideProduct<Number>::Fits(int64_t inputs, int64_t outputs) {
  return inputs * outputs >= kMinWeights && inputs % kColumns == 0 && outputs % kWord == 0 && FindKernels() != nullptr;
}

template <typename Number>
void WideProduct<Number>::Forward(int64_t rows, const Number* input, const Number* weight, float* output) const {
  const int64_t panels = (rows + kColumns - 1) / kColumns;
  const int64_t width = panels * kColumns;
  const int64_t words = inputs_ / kWord;  // of a row
  // [panels][kWordsAtOnce][64]; what lies behind the last row is padding
  const PooledBuffer transposed(kWordsAtOnce * width);
  const PooledBuffer sums(outputs_ * width);  // [outputs][width]
  std::memset(transposed.get(), 0, kWordsAtOnce * width * sizeof(float));
  for (int64_t k = 0; k < words; k += kWordsAtOnce) {
    const int64_t depth = std::min(kWordsAtOnce, words - k);
    const auto weights = RowPointers(outputs_, Words(weight) + k, words);
    for (int64_t panel = 0; panel < panels; ++panel) {
      const int64_t first = panel * kColumns;
      float* const columns = transposed.get() + first * kWordsAtOnce;
      Transpose(std::min(kColumns, rows - first), depth, Words(input) + first * words + k, words, columns, kColumns);
      kernels_.multiply(outputs_, weights.data(), {1, depth, 0}, columns, /*adds=*/k > 0,
                        RowPointers(outputs_, sums.get() + first, width).data());
    }
  }
  Transpose(outputs_, rows, sums.get(), width, output, outputs_);
}

template <typename Number>
void WideProduct<Number>::InputGradient(int64_t rows, const Number* output_gradient, const Number* weight,
                                        float* input_gradient) const {
  const int64_t depth = outputs_ / kWord;  // words of a sum
  const PooledBuffer packed(depth * kColumns);
  const PooledBuffer transposed(depth * rows);
  Transpose(rows, depth, Words(output_gradient), depth, transposed.get(), rows);
  const auto factors = RowPointers<const float>(depth, transposed.get(), rows);
  for (int64_t k = 0; k < inputs_; k += kColumns) {
    Pack(outputs_, kColumns, weight + k, inputs_, packed.get());
    kernels_.correlate(depth, factors.data(), rows, packed.get(), kColumns, /*adds=*/false, input_gradient + k,
                       inputs_);
  }
}

template <typename Number>
void WideProduct<Number>::WeightGradient(absl::Span<const Rows> shards, int64_t begin, int64_t end,
                                         absl::Span<float* const> parts) const {
  const auto words_of = [](const Rows& shard) { return (shard.count + kWord - 1) / kWord; };
  const int64_t part_outputs = outputs_ / static_cast<int64_t>(parts.size());
  std::vector<PooledBuffer> output_gradients;      // of each shard, in words
  std::vector<std::vector<const float*>> factors;  // of each shard, for each part
  int64_t most = 0;
  for (const Rows& shard : shards) {
    const int64_t words = words_of(shard);
    const float* const packed = output_gradients.emplace_back(words * outputs_).get();
    Pack(shard.count, outputs_, shard.output_gradient, outputs_, output_gradients.back().get());
    for (size_t part = 0; part < parts.size(); ++part) {
      factors.push_back(RowPointers(words, packed + part * part_outputs, outputs_));
    }
    most = std::max(most, words);
  }
  const PooledBuffer packed(most * kColumns);
  for (int64_t k = begin; k < end; k += kColumns) {
    for (size_t i = 0; i < shards.size(); ++i) {
      const Rows& shard = shards[i];
      Pack(shard.count, kColumns, shard.input + k, inputs_, packed.get());
      for (size_t part = 0; part < parts.size(); ++part) {
        kernels_.correlate(words_of(shard), factors[i * parts.size() + part].data(), part_outputs, packed.get(),
                           kColumns, /*adds=*/i > 0, parts[part] + k, inputs_);
      }
    }
  }
}

template class WideProduct<float>;
template class WideProduct<Bfloat16>;

}  // namespace craftfleet
