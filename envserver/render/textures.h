// The textures of the game, decoded: loaded once, shared by every renderer.
// Immutable after Load() or BuiltIn(): may be shared between threads.

#pragma once

#include <functional>
#include <map>
#include <memory>
#include <string>

#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>
#include <absl/types/span.h>

#include "common/io/texture_digest.h"
#include "envserver/render/png_texture.h"

namespace craftfleet {

// The PNG files of envserver/textures, compiled in (embed_textures.cmake): an environment server needs no files beside
// it. Sorted by name; valid as long as the program runs. Thread-safe.
absl::Span<const TextureFile> BuiltInTextures();

class Textures {
 public:
  // Reads "<name>.png" of every sprite, item and digit from `folder`. Those of appearance variants may be missing: the
  // renderer that needs one reports it.
  //   NotFound: a file is missing. InvalidArgument: DecodeTexture() refuses a file. Both name the file.
  static absl::StatusOr<std::shared_ptr<const Textures>> Load(const std::string& folder);

  // The textures that are compiled into the program.
  static std::shared_ptr<const Textures> BuiltIn();

  // Null only for appearance variants whose file was missing.
  const Texture* Find(absl::string_view name) const;
  // The file that a texture is read from, for messages.
  std::string PathOf(absl::string_view name) const;

 private:
  using FileReader = std::function<absl::StatusOr<std::string>(const std::string& path)>;

  // Fills `textures_` from the files of folder_, whose bytes `read` returns; NotFound for a file that is missing.
  absl::Status LoadAll(const FileReader& read);

  std::string folder_;
  std::map<std::string, Texture, std::less<>> textures_;
};

}  // namespace craftfleet
