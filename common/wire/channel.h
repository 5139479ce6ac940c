// Client channels with the settings that every program uses.

#pragma once

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
inline constexpr absl::string_view kUnix = "unix:";  // before the path of a Unix socket

// From this limit of open files on, a process can reserve descriptors for its calls.
inline constexpr rlim_t kPlentyOfFiles = 16384;

// A peer's address for messages (kInProcess without one), the channel to it (null: use ConnectApart to open one)
// and the channel's security.
struct Endpoint {
  std::string address;
  std::shared_ptr<grpc::Channel> channel;
  ChannelSecurity security = {};
};

// Keeps gRPC from shutting down with its last channel or server: in gRPC 1.51 that occasionally waits up to 10 s for a
// poller. Connect and Server::Create call it.
void KeepGrpcUp();

// Makes gRPC use poll(2), for programs with few connections: call after ParseFlags, before any other use of gRPC. By
// default one thread polls for all and wakes the waiting one, which doubles the context switches of a round trip; with
// poll(2) the waiting thread polls itself. It needs more descriptors (so it has no effect if the limit of open files is
// below kPlentyOfFiles), and its cost grows with the number of connections, so only clients with few may use it.
// GRPC_POLL_STRATEGY in the environment, if set, takes precedence.
void PollFewConnections();

// The accepted compression algorithms (GRPC_COMPRESSION_CHANNEL_ENABLED_ALGORITHMS_BITSET): none. A message of 1 MB may
// inflate to a thousand times its size before that is checked.
inline constexpr int kNoCompression = 1 << GRPC_COMPRESS_NONE;

// Message limits, no compression, and keepalive: a dead peer is detected within 10 seconds.
grpc::ChannelArguments ClientArguments();

// Channel to HOST:PORT or unix:PATH. Connects lazily; never fails.
Endpoint Connect(absl::string_view address, const ChannelSecurity& security = {});

// The same peer over a separate connection (not for kInProcess). Threads that share a connection wait for each other's
// messages, which doubled the time of a step of games.
Endpoint ConnectApart(const Endpoint& peer);

// `address` as gRPC wants it: it reads the path of a Unix socket as part of a URI.
std::string GrpcAddress(absl::string_view address);

// InvalidArgument, naming the flag, unless `address` looks like HOST:PORT (port 0..65535) or unix:PATH. Says what to
// write instead of a URL, an IPv6 address without brackets or a path that is too long for a Unix socket or has commas.
absl::Status CheckAddress(absl::string_view flag, absl::string_view address);

// Whether `address`, which passes CheckAddress, is reachable from this host only.
bool IsLoopback(absl::string_view address);

// The error of a call to `endpoint`: "<who>: ...", with advice if it concerns TLS or rights. OK if `status` is OK.
absl::Status FromCall(const grpc::Status& status, absl::string_view who, const Endpoint& endpoint);

// Connects now. Unavailable, naming `who`, the address and the reason: refused, not trusted, or no answer within
// `timeout`.
absl::Status WaitUntilConnected(absl::string_view who, const Endpoint& endpoint, absl::Duration timeout);

// Sets the deadline of a unary call to `timeout` from now.
void SetDeadline(grpc::ClientContext* context, absl::Duration timeout);

}  // namespace craftfleet::wire
