// A small HTTP server for pages that programs read: one answer a connection.

#ifndef CRAFTFLEET_COMMON_WIRE_HTTP_SERVER_H_
#define CRAFTFLEET_COMMON_WIRE_HTTP_SERVER_H_

#include <functional>
#include <memory>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>
#include <absl/time/time.h>

#include "common/mutex.h"
#include "common/wire/listener.h"

namespace craftfleet::wire {

// Plain HTTP/1.1 without keep-alive, for a few clients. Debian's civetweb, which prometheus-cpp's own server stands on,
// crashes at a request for an unknown path. Clients that send too much, nothing for a while or no HTTP are put out and
// harm nobody else. Two threads: the listener's, and one that serves all connections.
class HttpServer {
 public:
  static constexpr int kMaxConnections = 64;
  static constexpr absl::Duration kTimeout = absl::Seconds(3);  // for a connection from its beginning to its end

  struct Response {
    int code = 200;
    std::string content_type = "text/plain; charset=utf-8";
    std::string body;
  };
  // What GET `path` answers; called on the server's thread.
  using Respond = std::function<Response(absl::string_view path)>;

  // Listens on HOST:PORT; port 0: any free one.   Unavailable: the port is in use, or the host is not this machine.
  static absl::StatusOr<std::unique_ptr<HttpServer>> Create(const std::string& address, Respond respond);
  ~HttpServer();

  // With the port in use.
  const std::string& address() const { return listener_->address(); }

 private:
  struct Connection {
    int descriptor = -1;
    absl::Time deadline;
    std::string request;
    std::string response;  // empty: the request has not come whole
    size_t sent = 0;
  };

  explicit HttpServer(Respond respond) : respond_(std::move(respond)) {}

  void Run();
  void TakeNew() ABSL_LOCKS_EXCLUDED(mu_);
  // Reads or writes what there is. False: the connection has ended.
  bool Serve(Connection* connection);

  const Respond respond_;
  std::unique_ptr<Listener> listener_;
  int wake_up_[2] = {-1, -1};            // pipe: a byte for each new connection; closed: end
  std::vector<Connection> connections_;  // of the thread
  std::thread thread_;

  Mutex mu_;
  std::vector<int> new_ ABSL_GUARDED_BY(mu_);  // descriptors, from the listener's thread
};

// The whole answer to `request`, which is whatever came until the first empty line.
std::string AnswerHttp(absl::string_view request, const HttpServer::Respond& respond);

}  // namespace craftfleet::wire

#endif  // CRAFTFLEET_COMMON_WIRE_HTTP_SERVER_H_
