#include "common/agent/nets/product_kernels.h"

#if defined(__x86_64__)
#include <cpuid.h>

#include "common/base/cpu_path.h"
#endif

namespace craftfleet {

#if defined(__x86_64__)

namespace {

bool HasBf16WithoutAmx() {
  constexpr unsigned kAmxBf16 = 1U << 22;    // of edx in leaf 7, 0
  constexpr unsigned kAvx512Bf16 = 1U << 5;  // of eax in leaf 7, 1
  unsigned eax = 0;
  unsigned ebx = 0;
  unsigned ecx = 0;
  unsigned edx = 0;
  if (__get_cpuid_count(7, 0, &eax, &ebx, &ecx, &edx) == 0 || (edx & kAmxBf16) != 0) return false;
  return __get_cpuid_count(7, 1, &eax, &ebx, &ecx, &edx) != 0 && (eax & kAvx512Bf16) != 0;
}

}  // namespace

const ProductKernels* FindBf16Kernels() {
  static const bool has_them = HasBf16WithoutAmx();
  return has_them && CurrentCpuPath() == CpuPath::kAvx512 ? avx512::FindBf16Kernels() : nullptr;
}

#else

const ProductKernels* FindBf16Kernels() { return nullptr; }

#endif

}  // namespace craftfleet
