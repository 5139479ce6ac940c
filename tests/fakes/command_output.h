// The output of a shell command, for tests that run other programs.

#pragma once

#include <array>
#include <cstdio>
#include <string>

#include <absl/strings/str_cat.h>

namespace craftfleet {

// The output of `command`, standard error included.
inline std::string OutputOf(const std::string& command) {
  FILE* pipe = ::popen(absl::StrCat(command, " 2>&1").c_str(), "r");
  if (pipe == nullptr) return "popen failed";
  std::string output;
  std::array<char, 4096> buffer;
  while (const size_t n = std::fread(buffer.data(), 1, buffer.size(), pipe)) output.append(buffer.data(), n);
  ::pclose(pipe);
  return output;
}

}  // namespace craftfleet
