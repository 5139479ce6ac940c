// The Prometheus endpoint of every process.

#pragma once

#include <functional>
#include <memory>
#include <string>

#include <absl/status/status.h>
#include <absl/status/statusor.h>

#include "common/wire/http_server.h"
#include "craftfleet/v1/status.pb.h"

namespace craftfleet::wire {

// Serves http://ADDRESS/metrics, the current `snapshot` as Prometheus metrics (prometheus_metrics.h), and /healthz for
// probes: 200 while `serving` is true, 503 otherwise. Plain HTTP. Thread-safe.
class MetricsServer {
 public:
  struct Options {
    std::string address;    // HOST:PORT; port 0: any free one; empty: no server
    bool insecure = false;  // allow an address beyond loopback: every client that reaches it can read the metrics
    absl::Status Validate() const;
  };

  // `options.address` is not empty. `snapshot` and `serving` are called from other threads until the server is
  // destroyed.
  //   InvalidArgument: a bad address, or one beyond loopback without `insecure`.   Unavailable: cannot listen on the
  //   address.
  static absl::StatusOr<std::unique_ptr<MetricsServer>> Create(const Options& options,
                                                               std::function<v1::StatusReply()> snapshot,
                                                               std::function<bool()> serving);

  // "http://127.0.0.1:9464/metrics", with the port in use.
  const std::string& url() const { return url_; }

 private:
  explicit MetricsServer(std::unique_ptr<HttpServer> server);

  const std::unique_ptr<HttpServer> server_;
  const std::string url_;
};

}  // namespace craftfleet::wire
