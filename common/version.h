// What this build is.

#ifndef CRAFTFLEET_COMMON_VERSION_H_
#define CRAFTFLEET_COMMON_VERSION_H_

#include <string>

#include <absl/strings/string_view.h>

namespace craftfleet {

absl::string_view ProgramVersion();  // "0.1.0"
absl::string_view GitRevision();     // "39702b5", "39702b5-dirty"; "unknown" outside a checkout

// What workers tell each other of their build, "0.1.0 (39702b5)".
std::string BuildId();

// What --version prints: "<program> 0.1.0 (39702b5)", no newline.
std::string VersionText(absl::string_view program);

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_VERSION_H_
