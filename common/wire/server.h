// A gRPC server with health, reflection and limits; every program of the fleet runs one.

#ifndef CRAFTFLEET_COMMON_WIRE_SERVER_H_
#define CRAFTFLEET_COMMON_WIRE_SERVER_H_

#include <memory>
#include <string>
#include <vector>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/time/time.h>
#include <grpcpp/generic/async_generic_service.h>
#include <grpcpp/impl/service_type.h>
#include <grpcpp/server.h>

#include "common/wire/channel.h"
#include "common/wire/connection_watch.h"
#include "common/wire/listener.h"
#include "common/wire/protocol.h"
#include "common/wire/security.h"

namespace grpc::experimental {
class ExternalConnectionAcceptor;
}  // namespace grpc::experimental

namespace craftfleet::wire {

class AccessControl;

// Thread-safe after Create. The services must outlive the server.
class Server {
 public:
  struct Options {
    std::string address;           // HOST:PORT (port 0: any free one) or unix:PATH; empty: in-process channels only
    bool insecure = false;         // allow listening beyond loopback without TLS
    TlsFiles files = {};           // with a certificate: TLS
    bool ask_clients = true;       // with TLS and authorities: clients must present a certificate from one of them
    std::string access_file = {};  // rights of clients; empty: every authenticated client has all rights
    std::shared_ptr<AccessControl> access = nullptr;  // `access_file` as OpenAccess gave it; null: Create opens it
    // HOST:PORT of a second port without TLS that serves only health, for a few short connections; empty: none.
    std::string health_address = {};
    int max_connections_per_client = 1024;  // from one address, 1..65536
    // Largest accepted message, 1..kMaxMessageBytes; RESOURCE_EXHAUSTED beyond.
    int max_message_bytes = kMaxMessageBytes;
    // Memory for incoming and outgoing messages, MiB, 128..1000000. Beyond it calls end with RESOURCE_EXHAUSTED.
    int max_buffered_mb = 512;
    absl::Status Validate() const;
    // For services that identify callers: opens `access_file`, if there is one, as `access`. Errors as Create.
    absl::Status OpenAccess();
  };

  // InvalidArgument: a bad address, one beyond loopback with neither TLS nor `insecure`, or a bad file.   Unavailable:
  // the port is in use, or the host is not this machine.
  static absl::StatusOr<std::unique_ptr<Server>> Create(const Options& options,
                                                        const std::vector<grpc::Service*>& services);
  ~Server();

  // The address for clients, with the actual port.
  const std::string& address() const { return main_.address; }
  // The same for the health port; empty: no health port.
  const std::string& health_address() const { return health_.address; }
  // A channel without a socket.
  Endpoint InProcess();

  // Blocks until Stop was called.
  void Wait() { main_.server->Wait(); }
  // Refuses new calls, lets running ones continue for at most `timeout`, then cancels them. Idempotent.
  void Stop(absl::Duration timeout);

 private:
  // A gRPC server and the listener that feeds it; none for unix: and in-process.
  struct Port {
    std::vector<std::unique_ptr<grpc::experimental::ExternalConnectionAcceptor>> acceptors;
    std::unique_ptr<grpc::Server> server;
    std::unique_ptr<Listener> listener;
    std::string address;
    // Before the server is built.
    void AddAcceptors(grpc::ServerBuilder* builder, const std::shared_ptr<grpc::ServerCredentials>& credentials);
    // Starts accepting connections; ends those beyond the limits.
    void Listen(const ConnectionLimits& limits);
  };

  Server() = default;
  static absl::StatusOr<Port> Open(const Options& options, const std::string& address,
                                   std::shared_ptr<grpc::ServerCredentials> credentials,
                                   const std::vector<grpc::Service*>& services);
  static absl::StatusOr<Port> OpenHealth(const std::string& address, grpc::CallbackGenericService* nothing_else);

  grpc::CallbackGenericService nothing_else_;  // of the health port
  Port main_;
  Port health_;
};

}  // namespace craftfleet::wire

#endif  // CRAFTFLEET_COMMON_WIRE_SERVER_H_
