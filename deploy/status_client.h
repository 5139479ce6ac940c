// What `craftfleet status`, `top` and `admin` share: how they reach a process and ask for its status.

#ifndef CRAFTFLEET_DEPLOY_STATUS_CLIENT_H_
#define CRAFTFLEET_DEPLOY_STATUS_CLIENT_H_

#include <string>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>
#include <absl/time/time.h>

#include "common/wire/channel.h"
#include "craftfleet/v1/status.pb.h"

namespace craftfleet {

// Connects to the process at --address=`address`, which errors call `who`, as the flags of channel_flags.h say.
//   InvalidArgument: a bad address or file.   Unavailable: nobody answers within 3 s.
absl::StatusOr<wire::Endpoint> ConnectToProcess(absl::string_view who, absl::string_view address);

// InvalidArgument unless --interval=`interval` is one that a status stream has.
absl::Status CheckInterval(absl::Duration interval);

// One snapshot. Errors name the address.
absl::StatusOr<v1::StatusReply> AskStatus(const wire::Endpoint& process);

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_STATUS_CLIENT_H_
