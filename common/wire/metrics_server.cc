#include "common/wire/metrics_server.h"

#include <prometheus/text_serializer.h>

#include <utility>

#include <absl/strings/match.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>

#include "common/base/status_macros.h"
#include "common/base/status_prefix.h"
#include "common/wire/channel.h"
#include "common/wire/prometheus_metrics.h"

namespace craftfleet::wire {
namespace {

constexpr char kPath[] = "/metrics";
constexpr char kHealthPath[] = "/healthz";
constexpr char kContentType[] = "text/plain; version=0.0.4; charset=utf-8";

}  // namespace

absl::Status MetricsServer::Options::Validate() const {
  if (address.empty()) return absl::OkStatus();
  CRAFTFLEET_RETURN_IF_ERROR(CheckAddress("metrics_listen", address));
  if (absl::StartsWith(address, kUnix)) {
    return absl::InvalidArgumentError(absl::StrFormat("--metrics_listen=%s, want HOST:PORT", address));
  }
  if (!insecure && !IsLoopback(address)) {
    return absl::InvalidArgumentError(
        absl::StrFormat("--metrics_listen=%s reaches beyond this host, where anyone could read the metrics, which are "
                        "plain HTTP: listen on 127.0.0.1, or add --metrics_insecure if the network is trusted",
                        address));
  }
  return absl::OkStatus();
}

absl::StatusOr<std::unique_ptr<MetricsServer>> MetricsServer::Create(const Options& options,
                                                                     std::function<v1::StatusReply()> snapshot,
                                                                     std::function<bool()> serving) {
  CRAFTFLEET_RETURN_IF_ERROR(options.Validate());
  const auto respond = [snapshot = std::move(snapshot),
                        serving = std::move(serving)](const HttpServer::Request& request) -> HttpServer::Response {
    if (request.path() == kPath) {
      return {200, kContentType, prometheus::TextSerializer().Serialize(ToMetricFamilies(snapshot()))};
    }
    if (request.path() == kHealthPath && serving()) return {200, kContentType, "serving\n"};
    if (request.path() == kHealthPath) return {503, kContentType, "not serving\n"};
    return {404, kContentType, "metrics are at /metrics, health at /healthz\n"};
  };
  CRAFTFLEET_ASSIGN_OR_RETURN(std::unique_ptr<HttpServer> server,
                              WithPrefix("--metrics_listen", HttpServer::Create({options.address}, respond)));
  return std::unique_ptr<MetricsServer>(new MetricsServer(std::move(server)));
}

MetricsServer::MetricsServer(std::unique_ptr<HttpServer> server)
    : server_(std::move(server)), url_(absl::StrCat("http://", server_->address(), kPath)) {}

}  // namespace craftfleet::wire
