// The kernels of a convolution by FFT, compiled for AVX-512 and for AVX2. tiles.h and products.h say what they compute.

#pragma once

#include <cstdint>

#include "common/base/cpu_path.h"

namespace craftfleet {

// For tiles of one size. Arrays of floats are aligned to 64 bytes, but for weight and bias. Both variants compute the
// same bits.
struct FftKernels {
  static constexpr int64_t kFilterStep =
      2 * 64 * 64 + 80;  // floats between two frequencies of a filter; off powers of two

  int outputs;      // of a tile, a side
  int frequencies;  // of its spectrum
  int64_t (*scratch_floats)(int size);
  void (*transform_input)(int size, const float* map, float* spectra, int64_t chunk_tiles, float* scratch);
  void (*transform_gradient)(int size, const float* gradient, const uint8_t* mask, float* spectra, int64_t chunk_tiles,
                             float* scratch);
  void (*multiply)(int frequencies, int tiles, const float* spectra, const float* filter, float* products);
  void (*correlate)(int frequencies, int tiles, int chunk_tiles, const float* inputs, const float* gradients,
                    float* filter);
  void (*inverse_output)(int size, const float* spectra, const float* bias, float threshold, float* output,
                         uint8_t* mask, float* scratch);
  void (*inverse_gradient)(int size, const float* spectra, float* gradient, float* scratch);
  void (*transform_filter)(const float* weight, bool for_output, float* filter, float* taps, float* scratch);
  void (*inverse_filter)(const float* filter, float* gradient, float* taps, float* scratch);
};

// Those for maps of size x size pixels: a multiple of 32 (transforms of 36 points) or of 24 (28 points). Null: the maps
// are of another size, or `path` is the base CPU.
const FftKernels* FindFftKernels(CpuPath path, int64_t size);

namespace avx512 {
const FftKernels* FindFftKernels(int64_t size);
}
namespace avx2 {
const FftKernels* FindFftKernels(int64_t size);
}

}  // namespace craftfleet
