// Text that is safe on any terminal and in any log.

#pragma once

#include <string>

#include <absl/strings/ascii.h>
#include <absl/strings/string_view.h>

namespace craftfleet {

// `text` with a question mark for each byte that is not printable ASCII.
inline std::string Printable(absl::string_view text) {
  std::string printable(text);
  for (char& c : printable) {
    if (!absl::ascii_isprint(c)) c = '?';
  }
  return printable;
}

}  // namespace craftfleet
