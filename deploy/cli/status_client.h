// Connects `craftfleet status`, `top` and `admin` to a process, and gets its status.

#ifndef CRAFTFLEET_DEPLOY_CLI_STATUS_CLIENT_H_
#define CRAFTFLEET_DEPLOY_CLI_STATUS_CLIENT_H_

#include <string>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>
#include <absl/time/time.h>

#include "common/wire/channel.h"
#include "craftfleet/v1/status.pb.h"

namespace craftfleet {

// Connects to the process at --address=`address` with the flags of channel_flags.h. Errors call the process `who`.
//   InvalidArgument: a bad address or file.   Unavailable: no answer within 3 s.
absl::StatusOr<wire::Endpoint> ConnectToProcess(absl::string_view who, absl::string_view address);

// InvalidArgument unless --interval=`interval` is allowed for a status stream: 100 ms to 1 min.
absl::Status CheckInterval(absl::Duration interval);

// The current status. Errors name the address.
absl::StatusOr<v1::StatusReply> AskStatus(const wire::Endpoint& process);

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_CLI_STATUS_CLIENT_H_
