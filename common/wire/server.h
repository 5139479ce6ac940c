// A gRPC server with health and limits; every program of the fleet runs one.

#pragma once

#include <atomic>
#include <memory>
#include <string>
#include <vector>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/time/time.h>
#include <grpcpp/impl/service_type.h>
#include <grpcpp/server.h>

#include "common/wire/channel.h"
#include "common/wire/protocol.h"
#include "common/wire/security.h"

namespace craftfleet::wire {

class AccessControl;

// Thread-safe after Create. The services must outlive the server.
class Server {
 public:
  struct Options {
    std::string address;           // HOST:PORT (port 0: any free one) or unix:PATH; empty: in-process channels only
    bool insecure = false;         // allow listening beyond loopback without TLS
    TlsFiles files = {};           // with a certificate: TLS; clients must present one from an authority
    std::string access_file = {};  // rights of clients; empty: every authenticated client has all rights
    std::shared_ptr<AccessControl> access = nullptr;  // `access_file` as OpenAccess gave it; null: Create opens it
    // Largest accepted message, 1..kMaxMessageBytes; RESOURCE_EXHAUSTED beyond.
    int max_message_bytes = kMaxMessageBytes;
    // Memory for incoming and outgoing messages, MiB, 128..1000000. Beyond it calls end with RESOURCE_EXHAUSTED.
    int max_buffered_mb = 512;
    absl::Status Validate() const;
    // For services that check callers themselves: opens `access_file`, if there is one, as `access`. Errors as Create.
    absl::Status OpenAccess();
  };

  // `services`: at least one.
  //   InvalidArgument: a bad address, one beyond loopback with neither TLS nor `insecure`, or a bad or missing file.
  //   Unavailable: the port is in use, or the host is not this machine.   Others: a file can't be read.
  static absl::StatusOr<std::unique_ptr<Server>> Create(const Options& options,
                                                        const std::vector<grpc::Service*>& services);
  ~Server();

  // The address for clients, with the actual port.
  const std::string& address() const { return address_; }
  // Whether new calls are accepted: until Stop.
  bool serving() const { return serving_; }
  // A channel without a socket.
  Endpoint InProcess();

  // Blocks until Stop was called.
  void Wait() { server_->Wait(); }
  // Refuses new calls, lets running ones continue for at most `timeout`, then cancels them. Idempotent.
  void Stop(absl::Duration timeout);

 private:
  Server() = default;
  absl::Status Listen(const Options& options, std::shared_ptr<grpc::ServerCredentials> credentials,
                      const std::vector<grpc::Service*>& services);

  std::string address_;
  std::unique_ptr<grpc::Server> server_;
  std::atomic<bool> serving_{true};
};

}  // namespace craftfleet::wire
