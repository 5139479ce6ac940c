#include "common/agent/nets/direct_convolution/kernels.h"

namespace craftfleet {

const DirectKernels* FindDirectKernels([[maybe_unused]] CpuPath path) {
#if defined(__x86_64__)
  if (path == CpuPath::kAvx512) return avx512::FindDirectKernels();
  if (path == CpuPath::kAvx2) return avx2::FindDirectKernels();
#endif
  return nullptr;
}

}  // namespace craftfleet
