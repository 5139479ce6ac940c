#include "common/wire/metrics_flags.h"

#include <optional>
#include <string>

#include <absl/flags/flag.h>

#include "common/base/status_macros.h"
#include "common/telemetry/log.h"

namespace craftfleet::wire {

// An address that may be given as empty, which differs from not given: Abseil parses "" as an absent optional.
struct GivenAddress {
  std::optional<std::string> address;
};

// How absl reads and writes the flag below; found by argument-dependent lookup.
bool AbslParseFlag(absl::string_view text, GivenAddress* given, std::string* /*error*/) {
  given->address = std::string(text);
  return true;
}

std::string AbslUnparseFlag(const GivenAddress& given) { return given.address.value_or(""); }

}  // namespace craftfleet::wire

ABSL_FLAG(craftfleet::wire::GivenAddress, metrics_listen, {},
          "address to serve Prometheus metrics on, at http://HOST:PORT/metrics; empty: none\n"
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
                                                            StatusServiceImpl* status) {
  if (options.address.empty()) return nullptr;
  CRAFTFLEET_ASSIGN_OR_RETURN(std::unique_ptr<MetricsServer> server,
                              MetricsServer::Create(options, [status] { return status->Snapshot(); }));
  status->SetMetricsAddress(server->url());
  LogInfo("metrics on %s", server->url());
  return server;
}

}  // namespace craftfleet::wire
