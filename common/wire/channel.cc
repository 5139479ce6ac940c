#include "common/wire/channel.h"

#include <grpc/grpc.h>

#include <chrono>
#include <mutex>

#include <absl/status/status.h>
#include <absl/strings/match.h>
#include <absl/strings/numbers.h>
#include <absl/strings/str_format.h>
#include <grpcpp/create_channel.h>
#include <grpcpp/security/credentials.h>

#include "common/status_macros.h"
#include "common/wire/protocol.h"

namespace craftfleet::wire {

void KeepGrpcUp() {
  static std::once_flag once;
  std::call_once(once, grpc_init);
}

grpc::ChannelArguments ClientArguments() {
  grpc::ChannelArguments arguments;
  arguments.SetMaxReceiveMessageSize(kMaxMessageBytes);
  arguments.SetMaxSendMessageSize(kMaxMessageBytes);
  arguments.SetInt(GRPC_ARG_KEEPALIVE_TIME_MS, 5000);
  arguments.SetInt(GRPC_ARG_KEEPALIVE_TIMEOUT_MS, 4000);
  arguments.SetInt(GRPC_ARG_HTTP2_MAX_PINGS_WITHOUT_DATA, 0);
  arguments.SetInt(GRPC_ARG_INITIAL_RECONNECT_BACKOFF_MS, 200);
  arguments.SetInt(GRPC_ARG_MIN_RECONNECT_BACKOFF_MS, 1000);
  arguments.SetInt(GRPC_ARG_MAX_RECONNECT_BACKOFF_MS, 2000);
  // Channels to one server that are meant to be apart (one per thread) must not share a connection.
  arguments.SetInt(GRPC_ARG_USE_LOCAL_SUBCHANNEL_POOL, 1);
  return arguments;
}

Endpoint Connect(absl::string_view address) {
  KeepGrpcUp();
  return {std::string(address),
          grpc::CreateCustomChannel(std::string(address), grpc::InsecureChannelCredentials(), ClientArguments())};
}

absl::Status CheckAddress(absl::string_view flag, absl::string_view address) {
  if (absl::StartsWith(address, "unix:") && address.size() > 5) return absl::OkStatus();
  const size_t colon = address.rfind(':');
  int port = -1;
  if (colon == absl::string_view::npos || colon == 0 || !absl::SimpleAtoi(address.substr(colon + 1), &port) ||
      port < 0 || port > 65535) {
    return absl::InvalidArgumentError(
        absl::StrFormat("--%s: \"%s\" is no address, want HOST:PORT or unix:PATH", flag, address));
  }
  return absl::OkStatus();
}

absl::Status WaitUntilConnected(absl::string_view who, const Endpoint& endpoint, absl::Duration timeout) {
  if (endpoint.address == kInProcess) return absl::OkStatus();  // always connected; has no state to ask for
  const auto deadline = std::chrono::system_clock::now() + absl::ToChronoMilliseconds(timeout);
  while (true) {
    const grpc_connectivity_state state = endpoint.channel->GetState(/*try_to_connect=*/true);
    if (state == GRPC_CHANNEL_READY) return absl::OkStatus();
    if (state == GRPC_CHANNEL_TRANSIENT_FAILURE) {
      return absl::UnavailableError(
          absl::StrFormat("%s %s: cannot connect: nothing listens there, the host is unknown or it does not answer",
                          who, endpoint.address));
    }
    if (!endpoint.channel->WaitForStateChange(state, deadline)) {
      return absl::UnavailableError(
          absl::StrFormat("%s %s: no answer within %s", who, endpoint.address, absl::FormatDuration(timeout)));
    }
  }
}

void SetDeadline(grpc::ClientContext* context, absl::Duration timeout) {
  context->set_deadline(std::chrono::system_clock::now() + absl::ToChronoMilliseconds(timeout));
}

}  // namespace craftfleet::wire
