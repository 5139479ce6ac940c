// The bytes of a texture file: refused, or a picture of 16x16 pixels.

#include "common/base/check.h"
#include "common/io/files.h"
#include "common/io/paths.h"
#include "envserver/render/textures.h"
#include "tests/fuzz/fuzz_target.h"

namespace craftfleet {

void TryInput(absl::string_view input) {
  const auto texture = DecodeTexture(std::string(input), "input.png");
  CRAFTFLEET_CHECK(texture.ok() || texture.status().code() == absl::StatusCode::kInvalidArgument);
}

std::vector<std::string> SoundInputs() {
  const std::string folder = DefaultTextureDir().value();
  std::vector<std::string> inputs;
  for (const char* name : {"grass.png", "player.png", "1.png"}) {
    inputs.push_back(ReadFile(JoinPath(folder, name)).value());
  }
  return inputs;
}

}  // namespace craftfleet
