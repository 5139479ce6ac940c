// Compiled for AVX2 and FMA.

#if defined(__x86_64__)
#include "common/agent/nets/direct_convolution/simd_kernels.h"
#endif
