#include "common/agent/nets/direct_convolution/direct_convolution.h"

#include <algorithm>
#include <cstring>
#include <vector>

#include "common/agent/pooled_buffer.h"

namespace craftfleet {
namespace {

constexpr int kColumns = DirectKernels::kColumns;
// So that what the innermost loops read again stays in a core's cache of 1 MB, and rounding errors stay small: partial
// sums are added afterwards.
constexpr int64_t kDepthAtOnce = 512;   // numbers of a window: 128 KB of weights
constexpr int64_t kPixelsAtOnce = 512;  // 128 KB of gradients

// All pointers, moved by `offset`.
template <typename Float>
std::vector<Float*> Moved(const std::vector<Float*>& rows, int64_t offset) {
  std::vector<Float*> moved = rows;
  for (Float*& row : moved) row += offset;
  return moved;
}

}  // namespace

bool DirectConvolution::Fits(const DirectShape& shape, bool wants_input_gradient) {
  const bool has_input_gradient = shape.padding == 0 && shape.kernel * shape.channels % kColumns == 0;
  return FindDirectKernels(CurrentCpuPath()) != nullptr && shape.outputs % kColumns == 0 &&
         shape.size + 2 * shape.padding >= shape.kernel && (has_input_gradient || !wants_input_gradient);
}

int64_t DirectConvolution::chunk_maps() const { return std::max<int64_t>(1, kPixelsAtOnce / pixels()); }

template <typename Each>
void DirectConvolution::ForWeights(const Each& each) const {
  const int64_t area = shape_.kernel * shape_.kernel;
  for (int64_t first = 0; first < shape_.outputs; first += kColumns) {
    for (int64_t in = 0; in < shape_.channels; ++in) {
      for (int64_t place = 0; place < area; ++place) {
        const int64_t k = place * shape_.channels + in;
        for (int64_t out = first; out < first + kColumns; ++out) {
          each((out * shape_.channels + in) * area + place, out, k);
        }
      }
    }
  }
}

void DirectConvolution::ArrangeWeight(const float* weight, Use use, float* panels) const {
  if (use == Use::kOutput) {
    ForWeights([&](int64_t from, int64_t out, int64_t k) { panels[PanelIndex(out, k)] = weight[from]; });
    return;
  }
  const int64_t area = shape_.kernel * shape_.kernel;
  for (int64_t out = 0; out < shape_.outputs; ++out) {
    for (int64_t place = 0; place < area; ++place) {
      for (int64_t in = 0; in < shape_.channels; ++in) {
        const int64_t k = place * shape_.channels + in;
        panels[(k / kColumns * shape_.outputs + out) * kColumns + k % kColumns] =
            weight[(out * shape_.channels + in) * area + place];
      }
    }
  }
}

const float* DirectConvolution::Padded(int64_t maps, const float* input, float* padded) const {
  if (shape_.padding == 0) return input;
  const int64_t line = shape_.size * shape_.channels;
  std::memset(padded, 0, sizeof(float) * maps * map_floats());
  for (int64_t map = 0; map < maps; ++map) {
    for (int64_t y = 0; y < shape_.size; ++y) {
      std::memcpy(padded + map * map_floats() + (y + shape_.padding) * row() + shape_.padding * shape_.channels,
                  input + (map * shape_.size + y) * line, sizeof(float) * line);
    }
  }
  return padded;
}

template <typename Float>
std::vector<Float*> DirectConvolution::Windows(int64_t maps, Float* map) const {
  std::vector<Float*> windows;
  windows.reserve(maps * pixels());
  for (int64_t i = 0; i < maps; ++i) {
    for (int64_t y = 0; y < shape_.output_size(); ++y) {
      for (int64_t x = 0; x < shape_.output_size(); ++x) {
        windows.push_back(map + i * map_floats() + y * shape_.stride * row() + x * shape_.stride * shape_.channels);
      }
    }
  }
  return windows;
}

void DirectConvolution::Forward(int64_t n, const float* input, const float* panels, const float* bias, float* output,
                                uint8_t* mask) const {
  const int64_t input_floats = shape_.size * shape_.size * shape_.channels;
  const PooledBuffer padded(shape_.padding == 0 ? 0 : chunk_maps() * map_floats());
  const int64_t rows_at_once = std::max<int64_t>(1, kDepthAtOnce / stretch());
  const int64_t pieces = (stretch() + kDepthAtOnce - 1) / kDepthAtOnce;  // of a row
  const int64_t piece = (stretch() + pieces - 1) / pieces;
  for (int64_t first = 0; first < n; first += chunk_maps()) {
    const int64_t maps = std::min(n - first, chunk_maps());
    const auto windows = Windows(maps, Padded(maps, input + first * input_floats, padded.get()));
    const auto count = static_cast<int64_t>(windows.size());
    float* const chunk = output + first * pixels() * shape_.outputs;
    for (int64_t column = 0; column < shape_.outputs; column += kColumns) {
      const auto outputs = RowPointers(count, chunk + column, shape_.outputs);
      for (int64_t y = 0; y < shape_.kernel; y += rows_at_once) {
        for (int64_t k = 0; k < stretch(); k += piece) {
          const float* const panel = panels + (column / kColumns * window() + y * stretch() + k) * kColumns;
          kernels_.multiply(count, Moved(windows, y * row() + k).data(),
                            {std::min(rows_at_once, shape_.kernel - y), std::min(piece, stretch() - k), row()}, panel,
                            /*adds=*/y + k > 0, outputs.data());
        }
      }
      kernels_.finish(count, shape_.outputs, bias + column, chunk + column,
                      mask == nullptr ? nullptr : mask + mask_bytes(first) + column / 8);
    }
  }
}

void DirectConvolution::Backward(int64_t n, const float* output_gradient, const uint8_t* mask, const float* input,
                                 const float* panels, const Gradients& gradients) const {
  const int64_t input_floats = shape_.size * shape_.size * shape_.channels;
  const int64_t output_floats = pixels() * shape_.outputs;
  const PooledBuffer padded(shape_.padding == 0 ? 0 : chunk_maps() * map_floats());
  const PooledBuffer kept(mask == nullptr ? 0 : chunk_maps() * output_floats);
  const PooledBuffer sums(weight_floats());
  std::vector<double> bias_sums(shape_.outputs);
  for (int64_t first = 0; first < n; first += chunk_maps()) {
    const int64_t maps = std::min(n - first, chunk_maps());
    const float* chunk = output_gradient + first * output_floats;
    if (mask != nullptr) {
      kernels_.keep(maps * output_floats, chunk, mask + mask_bytes(first), kept.get());
      chunk = kept.get();
    }
    AddBiasGradient(maps * pixels(), chunk, &bias_sums);
    AddWeightGradient(maps, chunk, Padded(maps, input + first * input_floats, padded.get()), /*adds=*/first > 0,
                      sums.get());
    if (gradients.input != nullptr) {
      AddInputGradient(maps, chunk, panels, gradients.input + first * input_floats);
    }
  }
  std::copy(bias_sums.begin(), bias_sums.end(), gradients.bias);
  ForWeights([&](int64_t to, int64_t out, int64_t k) { gradients.weight[to] = sums.get()[PanelIndex(out, k)]; });
}

void DirectConvolution::AddBiasGradient(int64_t count, const float* output_gradient, std::vector<double>* sums) const {
  static constexpr float kOne = 1;
  const std::vector<const float*> ones(kPixelsAtOnce, &kOne);
  alignas(64) float part[kColumns];
  for (int64_t first = 0; first < count; first += kPixelsAtOnce) {
    for (int64_t column = 0; column < shape_.outputs; column += kColumns) {
      kernels_.correlate(std::min(kPixelsAtOnce, count - first), ones.data(), /*depth=*/1,
                         output_gradient + first * shape_.outputs + column, shape_.outputs, /*adds=*/false, part,
                         kColumns);
      for (int o = 0; o < kColumns; ++o) (*sums)[column + o] += part[o];
    }
  }
}

void DirectConvolution::AddWeightGradient(int64_t maps, const float* output_gradient, const float* map, bool adds,
                                          float* sums) const {
  const auto windows = Windows(maps, map);
  const auto count = static_cast<int64_t>(windows.size());
  for (int64_t y = 0; y < shape_.kernel; ++y) {
    const auto rows = Moved(windows, y * row());
    for (int64_t column = 0; column < shape_.outputs; column += kColumns) {
      float* const to = sums + (column / kColumns * window() + y * stretch()) * kColumns;
      for (int64_t first = 0; first < count; first += kPixelsAtOnce) {
        kernels_.correlate(std::min(kPixelsAtOnce, count - first), rows.data() + first, stretch(),
                           output_gradient + first * shape_.outputs + column, shape_.outputs, adds || first > 0, to,
                           kColumns);
      }
    }
  }
}

void DirectConvolution::AddInputGradient(int64_t maps, const float* output_gradient, const float* panels,
                                         float* gradient) const {
  std::memset(gradient, 0, sizeof(float) * maps * map_floats());
  const auto windows = Windows(maps, gradient);
  const auto count = static_cast<int64_t>(windows.size());
  const auto rows = RowPointers(count, output_gradient, shape_.outputs);
  for (int64_t y = 0; y < shape_.kernel; ++y) {
    for (int64_t k = 0; k < stretch(); k += kColumns) {
      const float* const panel = panels + (y * stretch() + k) * shape_.outputs;
      kernels_.multiply(count, rows.data(), {1, shape_.outputs, 0}, panel, /*adds=*/true,
                        Moved(windows, y * row() + k).data());
    }
  }
}

}  // namespace craftfleet
