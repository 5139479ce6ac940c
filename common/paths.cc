#include "common/paths.h"

#include <filesystem>
#include <system_error>

#include <absl/strings/str_cat.h>

namespace craftfleet {

absl::StatusOr<std::string> DefaultTextureDir() {
  std::error_code error;
  const std::filesystem::path program = std::filesystem::read_symlink("/proc/self/exe", error);
  const std::filesystem::path folder = program.parent_path().parent_path() / "share/craftfleet/textures";
  if (!error && std::filesystem::is_directory(folder, error)) return folder.string();
  return absl::NotFoundError(absl::StrCat("no textures in ", folder.string(), ", want --textures=DIR"));
}

absl::StatusOr<std::string> TextureDir(const std::string& folder) {
  return folder.empty() ? DefaultTextureDir() : folder;
}

}  // namespace craftfleet
