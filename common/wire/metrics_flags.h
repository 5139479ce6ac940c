// The flags of the Prometheus endpoint, the same in every program of the fleet.

#pragma once

#include <functional>
#include <memory>

#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>

#include "common/wire/metrics_server.h"
#include "common/wire/status_service.h"

namespace craftfleet::wire {

inline constexpr char kAnyFreePort[] = "127.0.0.1:0";

// The options from the flags; `by_default` is the address without a flag. InvalidArgument as MetricsServer::Options.
absl::StatusOr<MetricsServer::Options> MetricsOptionsFromFlags(absl::string_view by_default);

// Serves the metrics of `status`, which outlives the server, and whether the process is `serving`; logs the address and
// adds it to the status.
// Null: options.address is empty.   Errors as MetricsServer::Create.
absl::StatusOr<std::unique_ptr<MetricsServer>> ServeMetrics(const MetricsServer::Options& options,
                                                            StatusServiceImpl* status, std::function<bool()> serving);

}  // namespace craftfleet::wire
