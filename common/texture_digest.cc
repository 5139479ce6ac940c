#include "common/texture_digest.h"

#include <cstdint>
#include <vector>

#include <absl/strings/match.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/strings/string_view.h>

#include "common/files.h"
#include "common/fnv1a.h"
#include "common/status_macros.h"

namespace craftfleet {

absl::StatusOr<std::string> TextureDigest(const std::string& folder) {
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::vector<std::string> names, ListFolder(folder));
  uint64_t hash = kFnv1aBasis;
  bool any = false;
  for (const std::string& name : names) {
    if (!absl::EndsWith(name, ".png")) continue;
    CRAFTFLEET_ASSIGN_OR_RETURN(const std::string bytes, ReadFile(JoinPath(folder, name)));
    hash = Fnv1a(Fnv1a(hash, name), absl::string_view("\0", 1));
    hash = Fnv1a(hash, bytes);
    any = true;
  }
  if (!any) return absl::NotFoundError(absl::StrCat("no *.png in ", folder));
  return absl::StrFormat("%016x", hash);
}

}  // namespace craftfleet
