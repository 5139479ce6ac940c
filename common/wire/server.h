// A gRPC server with health and reflection, as every program of the fleet runs one.

#ifndef CRAFTFLEET_COMMON_WIRE_SERVER_H_
#define CRAFTFLEET_COMMON_WIRE_SERVER_H_

#include <memory>
#include <string>
#include <vector>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/time/time.h>
#include <grpcpp/impl/service_type.h>
#include <grpcpp/server.h>

#include "common/wire/channel.h"

namespace craftfleet::wire {

// Thread-safe after Create. The services must outlive the server.
class Server {
 public:
  struct Options {
    std::string address;    // HOST:PORT (port 0: any free one) or unix:PATH; empty: in-process channels only
    bool insecure = false;  // allow listening beyond loopback without TLS
    absl::Status Validate() const;
  };

  // InvalidArgument: a bad address, or one beyond loopback without `insecure`.   Unavailable: the port is in use or the
  // host is not ours.
  static absl::StatusOr<std::unique_ptr<Server>> Create(const Options& options,
                                                        const std::vector<grpc::Service*>& services);
  ~Server();

  // The address to give to others, with the port in use.
  const std::string& address() const { return address_; }
  // A channel without a socket.
  Endpoint InProcess();

  // Blocks until Stop was called.
  void Wait() { server_->Wait(); }
  // Refuses new calls, gives running ones until `timeout`, then cancels them. Idempotent.
  void Stop(absl::Duration timeout);

 private:
  Server(std::unique_ptr<grpc::Server> server, std::string address);

  const std::unique_ptr<grpc::Server> server_;
  const std::string address_;
};

}  // namespace craftfleet::wire

#endif  // CRAFTFLEET_COMMON_WIRE_SERVER_H_
