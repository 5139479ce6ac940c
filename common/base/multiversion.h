// CRAFTFLEET_MULTIVERSION before a function's definition compiles it for AVX-512, AVX2 and the base CPU; the loader
// selects one version at start. For hot loops over arrays that the compiler vectorises. Results are the same on every
// CPU because nothing is contracted or reassociated (-ffp-contract=off). Expands to nothing where the compiler, the C
// library or the CPU lacks support, and under sanitizers, whose run-time is not initialised when the loader selects.
// A run's `cpu` pins the instruction set of LibTorch and its libraries (common/process/cpu_pin.h); these loops need no
// pin, because their results do not depend on the selected version.

#pragma once

#if defined(__has_feature)
#if __has_feature(address_sanitizer) || __has_feature(thread_sanitizer) || __has_feature(memory_sanitizer)
#define CRAFTFLEET_SANITIZED_ 1
#endif
#endif
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
#define CRAFTFLEET_SANITIZED_ 1
#endif

#if defined(__x86_64__) && defined(__gnu_linux__) && __has_attribute(target_clones) && !defined(CRAFTFLEET_SANITIZED_)
#define CRAFTFLEET_MULTIVERSION __attribute__((target_clones("avx512f", "avx2", "default")))
#else
#define CRAFTFLEET_MULTIVERSION
#endif
