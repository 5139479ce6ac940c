#include "common/io/texture_digest.h"

#include <algorithm>
#include <cstdint>
#include <vector>

#include <absl/strings/match.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/strings/string_view.h>

#include "common/base/fnv1a.h"
#include "common/base/status_macros.h"
#include "common/io/files.h"

namespace craftfleet {

std::string TextureDigest(absl::Span<const TextureFile> files) {
  uint64_t hash = kFnv1aBasis;
  for (const TextureFile& file : files) {
    hash = Fnv1a(Fnv1a(hash, file.name), absl::string_view("\0", 1));
    hash = Fnv1a(hash, file.bytes);
  }
  return absl::StrFormat("%016x", hash);
}

absl::StatusOr<std::string> TextureDigest(const std::string& folder) {
  CRAFTFLEET_ASSIGN_OR_RETURN(std::vector<std::string> names, ListFolder(folder));
  names.erase(
      std::remove_if(names.begin(), names.end(), [](const std::string& name) { return !absl::EndsWith(name, ".png"); }),
      names.end());
  if (names.empty()) return absl::NotFoundError(absl::StrCat("no *.png in ", folder));
  std::vector<std::string> contents(names.size());
  std::vector<TextureFile> files;
  for (size_t i = 0; i < names.size(); ++i) {
    CRAFTFLEET_ASSIGN_OR_RETURN(contents[i], ReadFile(JoinPath(folder, names[i])));
    files.push_back({names[i], contents[i]});
  }
  return TextureDigest(files);
}

absl::Status CheckTextureDigest(absl::string_view run, absl::string_view played, absl::string_view here) {
  if (played == here) return absl::OkStatus();
  return absl::FailedPreconditionError(absl::StrCat(run, " was played with textures ", played,
                                                    ", but this program has ", here,
                                                    ": give the run's textures with --textures"));
}

}  // namespace craftfleet
