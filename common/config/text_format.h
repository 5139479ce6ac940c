// Reads files in protobuf's text format, with errors that a person can act on.

#pragma once

#include <absl/status/status.h>
#include <absl/strings/string_view.h>
#include <google/protobuf/message.h>

namespace craftfleet {

// Fills `message` from `text`.
//   InvalidArgument: "<filename>:<line>:<column>: ..." with the field and, if it is unknown, the known ones.
absl::Status ParseTextFormat(absl::string_view text, absl::string_view filename, google::protobuf::Message* message);

}  // namespace craftfleet
