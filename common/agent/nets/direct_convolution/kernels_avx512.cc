// Compiled for AVX-512 (F, BW, DQ, VL).

#if defined(__x86_64__)
#include "common/agent/nets/direct_convolution/simd_kernels.h"
#endif
