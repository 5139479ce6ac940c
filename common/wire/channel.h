// Client channels with the settings that every program uses.

#ifndef CRAFTFLEET_COMMON_WIRE_CHANNEL_H_
#define CRAFTFLEET_COMMON_WIRE_CHANNEL_H_

#include <memory>
#include <string>
#include <vector>

#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>
#include <absl/time/time.h>
#include <grpcpp/channel.h>
#include <grpcpp/client_context.h>
#include <grpcpp/support/channel_arguments.h>

namespace craftfleet::wire {

inline constexpr char kInProcess[] = "in-process";

// A peer's address for messages (kInProcess where there is none) and the channel to it.
struct Endpoint {
  std::string address;
  std::shared_ptr<grpc::Channel> channel;
};

// Keeps gRPC from shutting down with its last channel or server: in 1.51 that waits up to 10 s for a poller every now
// and then. Connect and Server::Create call it.
void KeepGrpcUp();

// Message limits and keepalive: a dead peer is noticed within 10 seconds.
grpc::ChannelArguments ClientArguments();

// Channel to HOST:PORT or unix:PATH. Connects lazily; never fails.
Endpoint Connect(absl::string_view address);

// InvalidArgument, naming the flag, unless `address` looks like HOST:PORT (port 0..65535) or unix:PATH.
absl::Status CheckAddress(absl::string_view flag, absl::string_view address);

// Connects now. Unavailable, naming `who` and the address: refused, or no answer within `timeout`.
absl::Status WaitUntilConnected(absl::string_view who, const Endpoint& endpoint, absl::Duration timeout);

// Deadline for a unary call.
void SetDeadline(grpc::ClientContext* context, absl::Duration timeout);

}  // namespace craftfleet::wire

#endif  // CRAFTFLEET_COMMON_WIRE_CHANNEL_H_
