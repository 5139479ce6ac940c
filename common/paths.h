// Where the installed files of this project lie.

#ifndef CRAFTFLEET_COMMON_PATHS_H_
#define CRAFTFLEET_COMMON_PATHS_H_

#include <string>

#include <absl/status/statusor.h>

namespace craftfleet {

// ../share/craftfleet/`name` from the running program's folder, whatever the working directory. NotFound: it is not
// there.
absl::StatusOr<std::string> InstalledPath(const std::string& name);

// The textures that come with the programs. NotFound: there is no such folder.
absl::StatusOr<std::string> DefaultTextureDir();

// What --textures means: `folder`, or DefaultTextureDir() if it is empty.
absl::StatusOr<std::string> TextureDir(const std::string& folder);

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_PATHS_H_
