// Paths of this project's installed files.

#pragma once

#include <string>

#include <absl/status/statusor.h>

namespace craftfleet {

// ../share/craftfleet/`name` relative to the running program's folder, whatever the working directory. NotFound: no
// such file or folder.
absl::StatusOr<std::string> InstalledPath(const std::string& name);

// The bundled textures. NotFound: no such folder.
absl::StatusOr<std::string> DefaultTextureDir();

// The folder that --textures selects: `folder`, or DefaultTextureDir() if it is empty.
absl::StatusOr<std::string> TextureDir(const std::string& folder);

}  // namespace craftfleet
