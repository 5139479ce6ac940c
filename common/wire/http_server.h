// A small HTTP server for pages that programs and browsers read, on libmicrohttpd.

#ifndef CRAFTFLEET_COMMON_WIRE_HTTP_SERVER_H_
#define CRAFTFLEET_COMMON_WIRE_HTTP_SERVER_H_

#include <functional>
#include <memory>
#include <string>
#include <utility>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>
#include <absl/time/time.h>

#include "common/wire/listener.h"

struct MHD_Daemon;

namespace craftfleet::wire {

// Plain HTTP/1.1 without keep-alive: GET and HEAD, one request per connection. Two threads for any number of clients:
// the listener's accepts connections, libmicrohttpd's serves them. Thread-safe. The limits, and what enforces each:
//   connections in all and of one address       Listener, which logs refusals; MHD_OPTION_*_LIMIT for half-closed
//                                               ones, which the listener no longer counts
//   bytes of a request, and memory for it       MHD_OPTION_CONNECTION_MEMORY_LIMIT; 414 or 431 beyond
//   time, from the connection to its last byte  Watchdog; libmicrohttpd's own timeout restarts with each byte
class HttpServer {
 public:
  static constexpr int kMaxConnections = 128;
  static constexpr int kMaxConnectionsPerClient = 64;
  static constexpr size_t kMaxRequestBytes = 8192;  // browsers and scrapers send less
  static constexpr absl::Duration kTimeout = absl::Seconds(3);

  struct Response {
    int code = 200;
    std::string content_type = "text/plain; charset=utf-8";
    std::string body;
  };
  // Returns the response to GET `path`, without its query. Called on the server's thread, one call at a time.
  using Respond = std::function<Response(absl::string_view path)>;

  // Listens on HOST:PORT; port 0: any free one.
  //   Unavailable: the port is in use, or the host is not this machine.   ResourceExhausted: no thread or descriptor.
  static absl::StatusOr<std::unique_ptr<HttpServer>> Create(const std::string& address, Respond respond);
  // Ends open connections.
  ~HttpServer();

  // HOST:PORT with the actual port.
  const std::string& address() const { return listener_->address(); }

 private:
  explicit HttpServer(Respond respond) : respond_(std::move(respond)) {}

  absl::Status Start(const std::string& address);

  const Respond respond_;
  std::unique_ptr<Listener> listener_;
  MHD_Daemon* daemon_ = nullptr;
};

}  // namespace craftfleet::wire

#endif  // CRAFTFLEET_COMMON_WIRE_HTTP_SERVER_H_
