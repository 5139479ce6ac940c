// The expected canary of environment servers (envserver/canary.h), for programs without the game.

#pragma once

#include <absl/strings/string_view.h>

namespace craftfleet {

// The game is deterministic, so every machine computes this canary. It changes with the rules, the rendering and the
// bundled textures; tests/envserver/canary_test.cc fails then.
inline constexpr absl::string_view kBuiltInTextures = "3024e54bf17f9958";
inline constexpr absl::string_view kBuiltInGameCanary = "191d27feb8c2eb62";

// The canary of games drawn with the textures of `digest` (common/io/texture_digest.h); empty: unknown textures.
inline absl::string_view KnownGameCanary(absl::string_view digest) {
  return digest == kBuiltInTextures ? kBuiltInGameCanary : absl::string_view();
}

}  // namespace craftfleet
