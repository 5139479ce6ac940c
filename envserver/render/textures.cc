#include "envserver/render/textures.h"

#include <algorithm>

#include <absl/status/status.h>
#include <absl/strings/str_cat.h>

#include "common/base/check.h"
#include "common/base/crafter.h"
#include "common/base/status_macros.h"
#include "common/io/files.h"
#include "envserver/render/sprites.h"
#include "envserver/world/state.h"

namespace craftfleet {
namespace {

constexpr absl::string_view kBuiltInFolder = "built-in";

absl::StatusOr<std::string> ReadBuiltIn(const std::string& path) {
  const absl::Span<const TextureFile> files = BuiltInTextures();
  const auto* file = std::find_if(files.begin(), files.end(), [&](const TextureFile& candidate) {
    return path == absl::StrCat(kBuiltInFolder, "/", candidate.name);
  });
  if (file == files.end()) return absl::NotFoundError(absl::StrCat("no texture ", path));
  return std::string(file->bytes);
}

}  // namespace

absl::Status Textures::LoadAll(const FileReader& read) {
  const auto load = [&](const std::string& name) -> absl::Status {
    CRAFTFLEET_ASSIGN_OR_RETURN(const std::string bytes, read(PathOf(name)));
    CRAFTFLEET_ASSIGN_OR_RETURN(textures_[name], DecodeTexture(bytes, PathOf(name)));
    return absl::OkStatus();
  };
  for (Sprite sprite = 0; sprite < kNumSprites; ++sprite) {
    const absl::Status status = load(SpriteName(sprite));
    if (IsVariant(sprite) && absl::IsNotFound(status)) continue;
    CRAFTFLEET_RETURN_IF_ERROR(status);
  }
  for (const absl::string_view item : kItemNames) CRAFTFLEET_RETURN_IF_ERROR(load(std::string(item)));
  for (int digit = 1; digit <= kMaxItem; ++digit) CRAFTFLEET_RETURN_IF_ERROR(load(absl::StrCat(digit)));
  return absl::OkStatus();
}

absl::StatusOr<std::shared_ptr<const Textures>> Textures::Load(const std::string& folder) {
  auto textures = std::make_shared<Textures>();
  textures->folder_ = folder;
  CRAFTFLEET_RETURN_IF_ERROR(textures->LoadAll(ReadFile));
  return textures;
}

std::shared_ptr<const Textures> Textures::BuiltIn() {
  auto textures = std::make_shared<Textures>();
  textures->folder_ = std::string(kBuiltInFolder);
  CRAFTFLEET_CHECK(textures->LoadAll(ReadBuiltIn).ok());
  return textures;
}

const Texture* Textures::Find(absl::string_view name) const {
  const auto found = textures_.find(name);
  return found == textures_.end() ? nullptr : &found->second;
}

std::string Textures::PathOf(absl::string_view name) const { return JoinPath(folder_, absl::StrCat(name, ".png")); }

}  // namespace craftfleet
