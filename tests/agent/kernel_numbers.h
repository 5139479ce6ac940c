// Numbers for tests of kernels, and what they are compared by.

#ifndef CRAFTFLEET_TESTS_AGENT_KERNEL_NUMBERS_H_
#define CRAFTFLEET_TESTS_AGENT_KERNEL_NUMBERS_H_

#include <cstdint>
#include <vector>

#include <ATen/ATen.h>

#include "common/base/cpu_path.h"
#include "common/base/keyed_random.h"

namespace craftfleet::testing {

// Relative error of float32 kernels against float64 that tests accept, in the L2 norm.
constexpr double kMaxError = 6e-7;

// The instruction sets that have kernels of their own, and this CPU.
inline std::vector<CpuPath> KernelPaths() {
  std::vector<CpuPath> paths;
  for (const CpuPath path : {CpuPath::kAvx2, CpuPath::kAvx512}) {
    if (CpuHas(path)) paths.push_back(path);
  }
  return paths;
}

// Numbers in [-scale / 2, scale / 2) that depend on `stream`, to[count].
inline void FillNumbers(int64_t count, uint64_t stream, double scale, float* to) {
  for (int64_t i = 0; i < count; ++i) {
    to[i] = static_cast<float>(scale * (UnitInterval(MixBits(stream * kKeyedGamma + i)) - 0.5));
  }
}

inline at::Tensor Numbers(at::IntArrayRef shape, uint64_t stream, double scale) {
  at::Tensor numbers = at::empty(shape);
  FillNumbers(numbers.numel(), stream, scale, numbers.data_ptr<float>());
  return numbers;
}

// `want` is float64.
inline double RelativeError(const at::Tensor& want, const at::Tensor& got) {
  return ((want - got.to(at::kDouble)).norm() / want.norm()).item<double>();
}

}  // namespace craftfleet::testing

#endif  // CRAFTFLEET_TESTS_AGENT_KERNEL_NUMBERS_H_
