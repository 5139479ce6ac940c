// Version and git revision of this build.

#pragma once

#include <string>

#include <absl/strings/string_view.h>

namespace craftfleet {

absl::string_view ProgramVersion();  // "0.2.0"
absl::string_view GitRevision();     // "39702b5", "39702b5-dirty"; "unknown" outside a checkout

// Identifies the build to other processes: "0.2.0 (39702b5)".
std::string BuildId();

// The output of --version without a newline: "<program> 0.2.0 (39702b5)".
std::string VersionText(absl::string_view program);

}  // namespace craftfleet
