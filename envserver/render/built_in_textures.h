// The PNG files of envserver/textures, compiled into the program: an environment server needs no files beside it. The
// build makes the source from them (embed_textures.cmake). Thread-safe.

#pragma once

#include <absl/strings/string_view.h>
#include <absl/types/span.h>

#include "common/io/texture_digest.h"

namespace craftfleet {

// Sorted by name; valid as long as the program runs.
absl::Span<const TextureFile> BuiltInTextures();

}  // namespace craftfleet
