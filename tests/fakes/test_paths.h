// Where tests find files of the source tree and programs of the build. Only test_paths.cc is compiled with these paths,
// so that a compiler cache has the other tests of a checkout in another folder.

#pragma once

#include <string>
#include <vector>

#include <absl/strings/string_view.h>

namespace craftfleet {

// `path` is relative to the top of the source tree.
std::string SourcePath(absl::string_view path);

// `name` is relative to bin/ of the build.
std::string BuiltProgram(absl::string_view name);

// The words that start a program in bin/ or a command, such as "craftfleet-actor" or "craftfleet train".
std::vector<std::string> BuiltCommand(absl::string_view name);

}  // namespace craftfleet
