// Client channels with the settings that every program uses.

#ifndef CRAFTFLEET_COMMON_WIRE_CHANNEL_H_
#define CRAFTFLEET_COMMON_WIRE_CHANNEL_H_

#include <grpc/compression.h>
#include <sys/resource.h>

#include <memory>
#include <string>
#include <vector>

#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>
#include <absl/time/time.h>
#include <grpcpp/channel.h>
#include <grpcpp/client_context.h>
#include <grpcpp/support/channel_arguments.h>
#include <grpcpp/support/status.h>

#include "common/wire/security.h"

namespace craftfleet::wire {

inline constexpr char kInProcess[] = "in-process";

// A limit of open files from which on a process can keep some for its calls.
inline constexpr rlim_t kPlentyOfFiles = 16384;

// A peer's address for messages (kInProcess where there is none), the channel to it (null: only ConnectApart will do)
// and what that shows and wants.
struct Endpoint {
  std::string address;
  std::shared_ptr<grpc::Channel> channel;
  ChannelSecurity security = {};
};

// Keeps gRPC from shutting down with its last channel or server: in 1.51 that waits up to 10 s for a poller every now
// and then. Connect and Server::Create call it.
void KeepGrpcUp();

// Makes gRPC poll(2), for programs with few connections: call after ParseFlags, before anything else of gRPC. By
// default one thread polls for all and wakes the one that waits, which doubles the switches of a round trip; with
// poll(2) that one polls itself. It takes some more descriptors (nothing changes where the limit of open files is below
// kPlentyOfFiles), and the more time the more connections there are, so it is nothing for a learner. GRPC_POLL_STRATEGY
// in the environment, if set, prevails.
void PollFewConnections();

// What a process takes, in the bits of GRPC_COMPRESSION_CHANNEL_ENABLED_ALGORITHMS_BITSET: nothing compressed. A
// message of 1 MB may inflate to a thousand times of that, before its size is looked at.
inline constexpr int kNoCompression = 1 << GRPC_COMPRESS_NONE;

// Message limits, no decompression, and keepalive: a dead peer is noticed within 10 seconds.
grpc::ChannelArguments ClientArguments();

// Channel to HOST:PORT or unix:PATH. Connects lazily; never fails.
Endpoint Connect(absl::string_view address, const ChannelSecurity& security = {});

// The same peer over a connection of its own; kInProcess has none. Threads that share a connection wait for each
// other's messages: a step of games took twice as long.
Endpoint ConnectApart(const Endpoint& peer);

// InvalidArgument, naming the flag, unless `address` looks like HOST:PORT (port 0..65535) or unix:PATH.
absl::Status CheckAddress(absl::string_view flag, absl::string_view address);

// Whether only this host reaches `address`, one that CheckAddress takes.
bool IsLoopback(absl::string_view address);

// The error of a call to `endpoint`: "<who>: ..." with what to check about TLS, tokens and rights where it is about
// them. Ok if `status` is.
absl::Status FromCall(const grpc::Status& status, absl::string_view who, const Endpoint& endpoint);

// Connects now. Unavailable, naming `who`, the address and what is wrong: refused, not trusted, or no answer within
// `timeout`.
absl::Status WaitUntilConnected(absl::string_view who, const Endpoint& endpoint, absl::Duration timeout);

// Deadline for a unary call.
void SetDeadline(grpc::ClientContext* context, absl::Duration timeout);

}  // namespace craftfleet::wire

#endif  // CRAFTFLEET_COMMON_WIRE_CHANNEL_H_
