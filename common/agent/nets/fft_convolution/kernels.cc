#include "common/agent/nets/fft_convolution/kernels.h"

namespace craftfleet {

const FftKernels* FindFftKernels([[maybe_unused]] CpuPath path, [[maybe_unused]] int64_t size) {
#if defined(__x86_64__)
  if (path == CpuPath::kAvx512) return avx512::FindFftKernels(size);
  if (path == CpuPath::kAvx2) return avx2::FindFftKernels(size);
#endif
  return nullptr;
}

}  // namespace craftfleet
