// A small HTTP server for pages that programs and browsers read, on libmicrohttpd.

#pragma once

#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>
#include <absl/time/time.h>

#include "common/io/watched_file.h"
#include "common/wire/security.h"

struct MHD_Connection;

namespace craftfleet::wire {

// HTTP/1.1, plain or over TLS, on one thread for any number of clients. Thread-safe. The limits, and what enforces
// each:
//   connections in all and of one address       MHD_OPTION_*CONNECTION_LIMIT: further ones wait or are closed
//   bytes of a request, and memory for it       MHD_OPTION_CONNECTION_MEMORY_LIMIT; 414 or 431 beyond
//   time, from the connection to the last byte  Watchdog; libmicrohttpd's own timeout restarts with each byte
class HttpServer {
 public:
  static constexpr int kMaxConnections = 128;
  static constexpr int kMaxConnectionsPerClient = 64;
  static constexpr size_t kMaxRequestBytes = 8192;  // browsers and scrapers send less

  struct Options {
    std::string address;                        // HOST:PORT; port 0: any free one
    TlsFiles files = {};                        // with a certificate: TLS; clients need no certificate
    absl::Duration timeout = absl::Seconds(3);  // of a connection; with keep_alive from one answer to the next
    bool accept_posts = false;                  // besides GET and HEAD; their bodies are not read
    bool keep_alive = false;                    // many requests per connection: saves TLS handshakes
  };

  // A request that is being answered.
  class Request {
   public:
    Request(MHD_Connection* connection, absl::string_view method, absl::string_view path)
        : connection_(connection), method_(method), path_(path) {}

    bool is_post() const { return method_ == "POST"; }
    absl::string_view path() const { return path_; }  // without its query
    // The value of a header, whatever the case of its name, or of an argument of the query. nullopt: not there.
    std::optional<absl::string_view> Header(const char* name) const;
    std::optional<absl::string_view> Argument(const char* name) const;
    // The client's IP address, for the log.
    std::string Client() const;

   private:
    MHD_Connection* const connection_;
    const absl::string_view method_;
    const absl::string_view path_;
  };
  struct Response {
    int code = 200;
    std::string content_type = "text/plain; charset=utf-8";
    std::string body = {};
    std::vector<std::pair<std::string, std::string>> headers = {};  // further ones
  };
  // Returns the response to a request. Called on other threads, one call at a time.
  using Respond = std::function<Response(const Request&)>;

  // The files of `options` may be replaced while the server runs, as TlsFiles says.
  //   Unavailable: the port is in use, or the host is not this machine.   ResourceExhausted: no thread or descriptor.
  //   InvalidArgument: certificate and key do not fit.
  static absl::StatusOr<std::unique_ptr<HttpServer>> Create(const Options& options, Respond respond);
  // Ends open connections.
  ~HttpServer();

  // HOST:PORT with the actual port.
  const std::string& address() const { return address_; }

 private:
  class Daemons;

  HttpServer() = default;

  std::shared_ptr<Daemons> daemons_;  // shared with the watches' threads
  std::vector<std::unique_ptr<FileWatch>> watches_;
  std::string address_;
};

}  // namespace craftfleet::wire
