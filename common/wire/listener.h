// Accepts connections for a gRPC server, within limits.

#ifndef CRAFTFLEET_COMMON_WIRE_LISTENER_H_
#define CRAFTFLEET_COMMON_WIRE_LISTENER_H_

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>
#include <absl/time/time.h>

#include "common/base/clock.h"
#include "common/telemetry/limited_log.h"
#include "common/wire/hand_over.h"

struct addrinfo;

namespace craftfleet::wire {

// Listens on a TCP port and hands each connection over. gRPC's own listener is not used, because that of 1.51 has no
// limits and never recovers when the process runs out of file descriptors. Thread-compatible; has threads of its own.
class Listener {
 public:
  struct Options {
    std::string address;  // HOST:PORT; port 0: any free one
    int max_connections_per_client = 1024;
    int max_connections = 0;                             // in all; 0: as many as the limit of open files allows
    std::string limit = "--max_connections_per_client";  // named in the log when a client has too many
  };
  // Gets the client of each connection by a descriptor, and returns those to end, with reasons; called on the
  // listener's thread while there are connections: up to forty times a second, less often if it takes long, unless
  // memory grows.
  using Inspect = std::function<std::map<int, std::string>(const std::map<int, std::string>& connections)>;

  // Binds the port; connections wait in the backlog until Start.
  //   Unavailable: the port is in use, the host is unknown or not this machine.
  static absl::StatusOr<std::unique_ptr<Listener>> Create(const Options& options);
  ~Listener();

  // Starts accepting connections, which `handles` get (HandOver). Called at most once. Without `inspect` none is ended.
  void Start(std::vector<HandOver::Handle> handles, Inspect inspect = nullptr);
  // Closes the port. Connections that were handed over stay open; one that is not after a second is ended. Idempotent.
  void Stop();

  // HOST:PORT with the requested host and the actual port.
  const std::string& address() const { return address_; }

 private:
  explicit Listener(const Options& options) : options_(options) {}

  absl::Status Bind();
  absl::Status BindTo(const addrinfo& address);
  // For [::] on hosts without IPv6.
  absl::Status BindAllOfIpv4(const std::string& service);
  void Run();
  void Accept(int socket);
  // Hands a connection over and watches a copy of its descriptor, to learn when it has ended.
  void Admit(int descriptor, const std::string& client);
  void Forget(int copy);
  void EndInspected();
  void EndSlow();

  const Options options_;
  RealClock clock_;
  LimitedLog log_{&clock_};
  std::unique_ptr<HandOver> hand_over_;
  Inspect inspect_;
  absl::Time next_inspection_ = absl::InfinitePast();
  int64_t inspected_memory_ = 0;  // resident bytes after the last inspection
  std::string address_;
  int port_ = 0;
  std::vector<int> sockets_;
  int poll_ = -1;                           // epoll of sockets, copies and wake-up
  int wake_up_[2] = {-1, -1};               // pipe: ends the thread
  size_t max_connections_ = 0;              // in all
  std::map<int, std::string> connections_;  // copy -> client; of the thread, like the next
  std::map<std::string, int> per_client_;
  std::thread thread_;
};

}  // namespace craftfleet::wire

#endif  // CRAFTFLEET_COMMON_WIRE_LISTENER_H_
