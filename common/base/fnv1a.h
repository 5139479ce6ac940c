// 64-bit FNV-1a: detects accidental differences, not deliberate ones.

#pragma once

#include <cstdint>

#include <absl/strings/string_view.h>

namespace craftfleet {

inline constexpr uint64_t kFnv1aBasis = 0xcbf29ce484222325;
inline constexpr uint64_t kFnv1aPrime = 0x100000001b3;

// `hash`, kFnv1aBasis at first, extended by `bytes`.
inline uint64_t Fnv1a(uint64_t hash, absl::string_view bytes) {
  for (const char byte : bytes) hash = (hash ^ static_cast<uint8_t>(byte)) * kFnv1aPrime;
  return hash;
}

}  // namespace craftfleet
