#include "common/agent/nets/fft_convolution/fft_convolution.h"

#include <algorithm>
#include <vector>

#include "common/agent/pooled_buffer.h"

namespace craftfleet {
namespace {

// Maps between transforms and inverse transforms: their spectra are read from memory anyway, so more are no slower.
constexpr int64_t kChunk = 32;

}  // namespace

int64_t FftConvolution::filter_floats() const { return kernels_.frequencies * FftKernels::kFilterStep; }

int64_t FftConvolution::spectra_floats(int64_t n) const { return n * tiles_per_map() * tile_floats(); }

void FftConvolution::TransformFilter(const float* weight, Use use, float* filter) const {
  const PooledBuffer taps(kWeights);
  const PooledBuffer scratch(kernels_.scratch_floats(kernels_.outputs));
  kernels_.transform_filter(weight, use == Use::kOutput, filter, taps.get(), scratch.get());
}

void FftConvolution::Forward(int64_t n, const float* input, const float* filter, const float* bias, float* output,
                             uint8_t* mask, float* spectra) const {
  const int64_t chunk_floats = spectra_floats(std::min(n, kChunk));
  const PooledBuffer unkept(spectra == nullptr ? chunk_floats : 0);
  const PooledBuffer products(chunk_floats);
  const PooledBuffer scratch(kernels_.scratch_floats(size_));
  for (int64_t first = 0; first < n; first += kChunk) {
    const int64_t maps = std::min(n - first, kChunk);
    const int64_t tiles = maps * tiles_per_map();
    float* const chunk = spectra == nullptr ? unkept.get() : spectra + spectra_floats(first);
    for (int64_t i = 0; i < maps; ++i) {
      kernels_.transform_input(size_, input + (first + i) * map_floats(), chunk + i * tiles_per_map() * 2 * kChannels,
                               tiles, scratch.get());
    }
    kernels_.multiply(kernels_.frequencies, static_cast<int>(tiles), chunk, filter, products.get());
    for (int64_t i = 0; i < maps; ++i) {
      kernels_.inverse_output(size_, products.get() + spectra_floats(i), bias, kThreshold,
                              output + (first + i) * map_floats(), mask + mask_bytes(first + i), scratch.get());
    }
  }
}

void FftConvolution::Backward(int64_t n, const float* output_gradient, const uint8_t* mask, const float* spectra,
                              const float* filter, const Gradients& gradients) const {
  const PooledBuffer gradient_spectra(spectra_floats(n));
  const PooledBuffer products(gradients.input == nullptr ? 0 : spectra_floats(std::min(n, kChunk)));
  const PooledBuffer scratch(kernels_.scratch_floats(size_));
  std::vector<double> bias_sums(kChannels);
  for (int64_t first = 0; first < n; first += kChunk) {
    const int64_t maps = std::min(n - first, kChunk);
    const int64_t tiles = maps * tiles_per_map();
    float* const chunk = gradient_spectra.get() + spectra_floats(first);
    for (int64_t i = 0; i < maps; ++i) {
      kernels_.transform_gradient(size_, output_gradient + (first + i) * map_floats(), mask + mask_bytes(first + i),
                                  chunk + i * tiles_per_map() * 2 * kChannels, tiles, scratch.get());
    }
    // Frequency 0 of a tile is its sum.
    for (int64_t tile = 0; tile < tiles; ++tile) {
      for (int c = 0; c < kChannels; ++c) bias_sums[c] += chunk[tile * 2 * kChannels + c];
    }
    if (gradients.input == nullptr) continue;
    kernels_.multiply(kernels_.frequencies, static_cast<int>(tiles), chunk, filter, products.get());
    for (int64_t i = 0; i < maps; ++i) {
      kernels_.inverse_gradient(size_, products.get() + spectra_floats(i), gradients.input + (first + i) * map_floats(),
                                scratch.get());
    }
  }
  const PooledBuffer weight_filter(filter_floats());
  kernels_.correlate(kernels_.frequencies, static_cast<int>(n * tiles_per_map()),
                     static_cast<int>(kChunk * tiles_per_map()), spectra, gradient_spectra.get(), weight_filter.get());
  const PooledBuffer taps(kWeights);
  kernels_.inverse_filter(weight_filter.get(), gradients.weight, taps.get(), scratch.get());
  std::copy(bias_sums.begin(), bias_sums.end(), gradients.bias);
}

}  // namespace craftfleet
