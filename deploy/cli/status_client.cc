#include "deploy/cli/status_client.h"

#include "common/base/status_macros.h"
#include "common/wire/channel_flags.h"

namespace craftfleet {

absl::StatusOr<wire::Endpoint> ConnectToProcess(absl::string_view who, absl::string_view address) {
  CRAFTFLEET_RETURN_IF_ERROR(wire::CheckAddress("address", address));
  CRAFTFLEET_ASSIGN_OR_RETURN(const wire::ChannelSecurity security, wire::ChannelSecurityFromFlags());
  wire::Endpoint process = wire::Connect(address, security);
  CRAFTFLEET_RETURN_IF_ERROR(wire::WaitUntilConnected(who, process, absl::Seconds(3)));
  return process;
}

}  // namespace craftfleet
