#include "common/wire/metrics_server.h"

#include <prometheus/collectable.h>
#include <prometheus/exposer.h>

#include <exception>
#include <utility>
#include <vector>

#include <absl/strings/match.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>

#include "common/status_macros.h"
#include "common/wire/channel.h"
#include "common/wire/prometheus_metrics.h"

namespace craftfleet::wire {
namespace {

class StatusCollectable : public prometheus::Collectable {
 public:
  explicit StatusCollectable(std::function<v1::StatusReply()> snapshot) : snapshot_(std::move(snapshot)) {}
  std::vector<prometheus::MetricFamily> Collect() const override { return ToMetricFamilies(snapshot_()); }

 private:
  const std::function<v1::StatusReply()> snapshot_;
};

}  // namespace

absl::Status MetricsServer::Options::Validate() const {
  if (address.empty()) return absl::OkStatus();
  CRAFTFLEET_RETURN_IF_ERROR(CheckAddress("metrics_listen", address));
  if (absl::StartsWith(address, "unix:")) {
    return absl::InvalidArgumentError(absl::StrFormat("--metrics_listen=%s, want HOST:PORT", address));
  }
  if (!insecure && !IsLoopback(address)) {
    return absl::InvalidArgumentError(
        absl::StrFormat("--metrics_listen=%s reaches beyond this host, where anyone could read the metrics, which are "
                        "plain HTTP: listen "
                        "on 127.0.0.1, or add --metrics_insecure if the network is trusted",
                        address));
  }
  return absl::OkStatus();
}

absl::StatusOr<std::unique_ptr<MetricsServer>> MetricsServer::Create(const Options& options,
                                                                     std::function<v1::StatusReply()> snapshot) {
  CRAFTFLEET_RETURN_IF_ERROR(options.Validate());
  const size_t colon = options.address.rfind(':');
  const std::string host = options.address.substr(0, colon);
  // The HTTP server wants a number.
  const std::string bind = (host == "localhost" ? "127.0.0.1" : host) + options.address.substr(colon);
  std::unique_ptr<MetricsServer> server(new MetricsServer);
  server->collectable_ = std::make_shared<StatusCollectable>(std::move(snapshot));
  try {
    // A client that sends nothing is put out after a while; two threads are enough for a scraper and a person.
    server->exposer_ = std::make_unique<prometheus::Exposer>(std::vector<std::string>{
        "listening_ports", bind, "num_threads", "2", "request_timeout_ms", "3000", "enable_keep_alive", "no"});
    server->exposer_->RegisterCollectable(server->collectable_);
    server->url_ = absl::StrCat("http://", host, ":", server->exposer_->GetListeningPorts().at(0), "/metrics");
  } catch (const std::exception& error) {
    return absl::UnavailableError(
        absl::StrFormat("cannot serve metrics on %s (%s): the port is in use, or the host is not this machine; choose "
                        "another --metrics_listen",
                        options.address, error.what()));
  }
  return server;
}

MetricsServer::MetricsServer() = default;
MetricsServer::~MetricsServer() = default;

}  // namespace craftfleet::wire
