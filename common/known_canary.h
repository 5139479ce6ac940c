// What environment servers' canaries (envserver/canary.h) must be, for those who don't know the game.

#ifndef CRAFTFLEET_COMMON_KNOWN_CANARY_H_
#define CRAFTFLEET_COMMON_KNOWN_CANARY_H_

#include <absl/strings/string_view.h>

namespace craftfleet {

// The game is exact, so every machine's canary is this one. Changes with the rules, the pictures and the textures that
// come with the programs; tests/envserver/canary_test.cc tells.
inline constexpr absl::string_view kBuiltInTextures = "3024e54bf17f9958";
inline constexpr absl::string_view kBuiltInGameCanary = "191d27feb8c2eb62";

// The canary of games drawn with the textures of `digest` (common/texture_digest.h); empty: not known.
inline absl::string_view KnownGameCanary(absl::string_view digest) {
  return digest == kBuiltInTextures ? kBuiltInGameCanary : absl::string_view();
}

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_KNOWN_CANARY_H_
