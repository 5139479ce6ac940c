// Connects `craftfleet status` and `admin` to a process.

#pragma once

#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>

#include "common/wire/channel.h"

namespace craftfleet {

// Connects to the process at --address=`address` with the flags of channel_flags.h. Errors call the process `who`.
//   InvalidArgument: a bad address or file.   Unavailable: no answer within 3 s.
absl::StatusOr<wire::Endpoint> ConnectToProcess(absl::string_view who, absl::string_view address);

}  // namespace craftfleet
