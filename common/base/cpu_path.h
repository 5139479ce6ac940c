// Kernels compiled for several CPUs: AVX-512, AVX2 and the base CPU. Unlike CRAFTFLEET_MULTIVERSION, a test can force
// each of them. For loops over arrays that the compiler vectorises. Results are the same on every path because nothing
// is contracted or reassociated (-ffp-contract=off), but in two files whose results need not be exact, as their callers
// know by how much they may be wrong (noise_field.cc, rough_night.cc).
//
//     CRAFTFLEET_KERNEL_BODY void DoubleLoop(int count, float* values) { ... }
//     CRAFTFLEET_KERNEL(Double, DoubleLoop)  // defines Double(), with the same parameters

#pragma once

#include <atomic>

#include "common/base/check.h"

#if defined(__x86_64__)
#define CRAFTFLEET_X86_ 1
#endif

namespace craftfleet {

// From the narrowest to the widest instructions.
enum class CpuPath { kBase, kAvx2, kAvx512 };
inline constexpr CpuPath kCpuPaths[] = {CpuPath::kBase, CpuPath::kAvx2, CpuPath::kAvx512};

inline const char* CpuPathName(CpuPath path) {
  return path == CpuPath::kAvx512 ? "avx512" : path == CpuPath::kAvx2 ? "avx2" : "base";
}

// Whether this CPU can run the path.
inline bool CpuHas(CpuPath path) {
#ifdef CRAFTFLEET_X86_
  if (path == CpuPath::kAvx2) return __builtin_cpu_supports("avx2") != 0 && __builtin_cpu_supports("fma") != 0;
  if (path == CpuPath::kAvx512) {
    return __builtin_cpu_supports("avx512f") != 0 && __builtin_cpu_supports("avx512bw") != 0 &&
           __builtin_cpu_supports("avx512dq") != 0 && __builtin_cpu_supports("avx512vl") != 0;
  }
#endif
  return path == CpuPath::kBase;
}

namespace internal {
inline CpuPath WidestCpuPath() {
  if (CpuHas(CpuPath::kAvx512)) return CpuPath::kAvx512;
  return CpuHas(CpuPath::kAvx2) ? CpuPath::kAvx2 : CpuPath::kBase;
}
inline std::atomic<CpuPath> cpu_path = WidestCpuPath();
}  // namespace internal

// The path that kernels take: the widest one that the CPU has, unless a test forces another. Thread-safe.
inline CpuPath CurrentCpuPath() { return internal::cpu_path.load(std::memory_order_relaxed); }

// Forces a path that the CPU has on all threads as long as it lives. For tests and benchmarks.
class ScopedCpuPath {
 public:
  explicit ScopedCpuPath(CpuPath path) : previous_(CurrentCpuPath()) {
    CRAFTFLEET_CHECK(CpuHas(path));
    internal::cpu_path = path;
  }
  ~ScopedCpuPath() { internal::cpu_path = previous_; }
  ScopedCpuPath(const ScopedCpuPath&) = delete;
  ScopedCpuPath& operator=(const ScopedCpuPath&) = delete;

 private:
  const CpuPath previous_;
};

}  // namespace craftfleet

#define CRAFTFLEET_KERNEL_BODY inline __attribute__((always_inline))

#ifdef CRAFTFLEET_X86_
// The same with a body of its own for AVX-512.
#define CRAFTFLEET_WIDE_KERNEL(name, wide_body, body)                                               \
  template <typename... Args>                                                                       \
  __attribute__((target("avx512f,avx512bw,avx512dq,avx512vl"))) void name##OnAvx512(Args... args) { \
    wide_body(args...);                                                                             \
  }                                                                                                 \
  template <typename... Args>                                                                       \
  __attribute__((target("avx2,fma"))) void name##OnAvx2(Args... args) {                             \
    body(args...);                                                                                  \
  }                                                                                                 \
  template <typename... Args>                                                                       \
  void name(Args... args) {                                                                         \
    const ::craftfleet::CpuPath path = ::craftfleet::CurrentCpuPath();                              \
    if (path == ::craftfleet::CpuPath::kAvx512) return name##OnAvx512(args...);                     \
    if (path == ::craftfleet::CpuPath::kAvx2) return name##OnAvx2(args...);                         \
    body(args...);                                                                                  \
  }
#else
#define CRAFTFLEET_WIDE_KERNEL(name, wide_body, body) \
  template <typename... Args>                         \
  void name(Args... args) {                           \
    body(args...);                                    \
  }
#endif

#define CRAFTFLEET_KERNEL(name, body) CRAFTFLEET_WIDE_KERNEL(name, body, body)
