#include "tests/fakes/test_paths.h"

#include "common/io/files.h"

namespace craftfleet {

std::string SourcePath(absl::string_view path) { return JoinPath(CRAFTFLEET_SOURCE_DIR, path); }

std::string BuiltProgram(absl::string_view name) { return JoinPath(CRAFTFLEET_BIN_DIR, name); }

}  // namespace craftfleet
