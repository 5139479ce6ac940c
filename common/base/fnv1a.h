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

// The same over a word of 8 bytes at once, several times as fast, with the high bits mixed in; another hash than of its
// bytes one by one.
inline uint64_t Fnv1aWord(uint64_t hash, uint64_t word) {
  hash = (hash ^ word) * kFnv1aPrime;
  return hash ^ (hash >> 32);
}

}  // namespace craftfleet
