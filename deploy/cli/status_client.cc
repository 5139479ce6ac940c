#include "deploy/cli/status_client.h"

#include <absl/strings/str_cat.h>

#include "common/base/status_macros.h"
#include "common/wire/channel_flags.h"
#include "craftfleet/v1/status.grpc.pb.h"

namespace craftfleet {

absl::StatusOr<wire::Endpoint> ConnectToProcess(absl::string_view who, absl::string_view address) {
  CRAFTFLEET_RETURN_IF_ERROR(wire::CheckAddress("address", address));
  CRAFTFLEET_ASSIGN_OR_RETURN(const wire::ChannelSecurity security, wire::ChannelSecurityFromFlags());
  wire::Endpoint process = wire::Connect(address, security);
  CRAFTFLEET_RETURN_IF_ERROR(wire::WaitUntilConnected(who, process, absl::Seconds(3)));
  return process;
}

absl::Status CheckInterval(absl::Duration interval) {
  if (interval >= absl::Milliseconds(100) && interval <= absl::Minutes(1)) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrCat("--interval=", absl::FormatDuration(interval), ", want 100ms..1m"));
}

absl::StatusOr<v1::StatusReply> AskStatus(const wire::Endpoint& process) {
  grpc::ClientContext context;
  wire::SetDeadline(&context, absl::Seconds(2));
  v1::StatusReply reply;
  const grpc::Status status = v1::StatusService::NewStub(process.channel)->GetStatus(&context, {}, &reply);
  if (!status.ok()) return wire::FromCall(status, process.address, process);
  return reply;
}

}  // namespace craftfleet
