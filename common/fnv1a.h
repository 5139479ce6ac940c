// 64-bit FNV-1a: tells apart what differs by accident, not on purpose.

#ifndef CRAFTFLEET_COMMON_FNV1A_H_
#define CRAFTFLEET_COMMON_FNV1A_H_

#include <cstdint>

#include <absl/strings/string_view.h>

namespace craftfleet {

inline constexpr uint64_t kFnv1aBasis = 0xcbf29ce484222325;

// `hash`, kFnv1aBasis at first, with `bytes` taken in.
inline uint64_t Fnv1a(uint64_t hash, absl::string_view bytes) {
  for (const char byte : bytes) hash = (hash ^ static_cast<uint8_t>(byte)) * 0x100000001b3;
  return hash;
}

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_FNV1A_H_
