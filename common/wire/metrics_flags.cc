#include "common/wire/metrics_flags.h"

#include <functional>
#include <string>
#include <utility>

#include <absl/flags/flag.h>

#include "common/base/status_macros.h"
#include "common/process/flag_values.h"
#include "common/telemetry/log.h"

ABSL_FLAG(craftfleet::GivenAddress, metrics_listen, {},
          "address to serve Prometheus metrics on, at http://HOST:PORT/metrics, and health at /healthz; empty: none\n"
          "[any free port of this host, see the log; craftfleet train: none]");
ABSL_FLAG(bool, metrics_insecure, false,
          "allow --metrics_listen beyond this host; metrics are plain HTTP, readable by every client");

namespace craftfleet::wire {

absl::StatusOr<MetricsServer::Options> MetricsOptionsFromFlags(absl::string_view by_default) {
  MetricsServer::Options options;
  const std::string otherwise(by_default);
  options.address = absl::GetFlag(FLAGS_metrics_listen).address.value_or(otherwise);
  options.insecure = absl::GetFlag(FLAGS_metrics_insecure);
  CRAFTFLEET_RETURN_IF_ERROR(options.Validate());
  return options;
}

absl::StatusOr<std::unique_ptr<MetricsServer>> ServeMetrics(const MetricsServer::Options& options,
                                                            StatusServiceImpl* status, std::function<bool()> serving) {
  if (options.address.empty()) return nullptr;
  CRAFTFLEET_ASSIGN_OR_RETURN(std::unique_ptr<MetricsServer> server,
                              MetricsServer::Create(
                                  options, [status] { return status->Snapshot(); }, std::move(serving)));
  status->SetMetricsAddress(server->url());
  LogInfo("metrics on %s", server->url());
  return server;
}

}  // namespace craftfleet::wire
