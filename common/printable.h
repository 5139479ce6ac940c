// Text that any terminal and any log can take.

#ifndef CRAFTFLEET_COMMON_PRINTABLE_H_
#define CRAFTFLEET_COMMON_PRINTABLE_H_

#include <string>

#include <absl/strings/ascii.h>
#include <absl/strings/string_view.h>

namespace craftfleet {

// `text` in printable ASCII, with question marks for the rest.
inline std::string Printable(absl::string_view text) {
  std::string printable(text);
  for (char& c : printable) {
    if (!absl::ascii_isprint(c)) c = '?';
  }
  return printable;
}

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_PRINTABLE_H_
