#include "tests/fakes/test_paths.h"

#include <absl/strings/str_split.h>

#include "common/io/files.h"

namespace craftfleet {

std::string SourcePath(absl::string_view path) { return JoinPath(CRAFTFLEET_SOURCE_DIR, path); }

std::string BuiltProgram(absl::string_view name) { return JoinPath(CRAFTFLEET_BIN_DIR, name); }

std::vector<std::string> BuiltCommand(absl::string_view name) {
  std::vector<std::string> words = absl::StrSplit(name, ' ');
  words[0] = BuiltProgram(words[0]);
  return words;
}

}  // namespace craftfleet
