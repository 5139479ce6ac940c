// The table of kernels of one instruction set. Included by kernels_avx2.cc and kernels_avx512.cc alone.

#pragma once

#include "common/agent/nets/fft_convolution/kernels.h"
#include "common/agent/nets/fft_convolution/products.h"
#include "common/agent/nets/fft_convolution/tiles.h"

namespace craftfleet::CRAFTFLEET_SIMD {

template <int Q>
constexpr FftKernels kFftKernels = {
    Tiles<Q>::kOutputs,          TileFft<Q>::kFrequencies,  Tiles<Q>::ScratchFloats, Tiles<Q>::TransformInput,
    Tiles<Q>::TransformGradient, MultiplySpectra,           CorrelateSpectra,        Tiles<Q>::InverseOutput,
    Tiles<Q>::InverseGradient,   Tiles<Q>::TransformFilter, Tiles<Q>::InverseFilter,
};

const FftKernels* FindFftKernels(int64_t size) {
  if (size > 0 && size % kFftKernels<9>.outputs == 0) return &kFftKernels<9>;
  if (size > 0 && size % kFftKernels<7>.outputs == 0) return &kFftKernels<7>;
  return nullptr;
}

}  // namespace craftfleet::CRAFTFLEET_SIMD
