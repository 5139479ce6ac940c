#include "common/io/paths.h"

#include <filesystem>
#include <system_error>

#include <absl/strings/str_cat.h>

namespace craftfleet {

absl::StatusOr<std::string> InstalledPath(const std::string& name) {
  std::error_code error;
  const std::filesystem::path program = std::filesystem::read_symlink("/proc/self/exe", error);
  const std::filesystem::path path = program.parent_path().parent_path() / "share/craftfleet" / name;
  if (!error && std::filesystem::exists(path, error)) return path.string();
  return absl::NotFoundError(absl::StrCat(path.string(), " is not there"));
}

absl::StatusOr<std::string> DefaultTextureDir() {
  absl::StatusOr<std::string> folder = InstalledPath("textures");
  if (folder.ok()) return folder;
  return absl::NotFoundError(absl::StrCat(folder.status().message(), ", want --textures=DIR"));
}

absl::StatusOr<std::string> TextureDir(const std::string& folder) {
  return folder.empty() ? DefaultTextureDir() : folder;
}

}  // namespace craftfleet
