// The Prometheus endpoint of every process.

#pragma once

#include <prometheus/metric_family.h>

#include <functional>
#include <memory>
#include <string>
#include <vector>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>

#include "common/wire/http_server.h"
#include "common/wire/status_service.h"

namespace craftfleet::wire {

inline constexpr char kAnyFreePort[] = "127.0.0.1:0";

// The address from the flags (metrics_flags.cc), or `by_default`; empty: no metrics. Errors as CheckMetricsAddress.
absl::StatusOr<std::string> MetricsAddressFromFlags(absl::string_view by_default);

// InvalidArgument: not HOST:PORT, or beyond loopback, where every client that reaches it can read the metrics, without
// `insecure`.
absl::Status CheckMetricsAddress(absl::string_view address, bool insecure);

// Serves http://ADDRESS/metrics, the current status as Prometheus metrics, and /healthz for probes: 200 while `serving`
// is true, 503 otherwise. Plain HTTP. Logs the URL and adds it to `status`, which outlives the server. `serving` is
// called on other threads.
// Null: `address` is empty.   Unavailable: cannot listen on it.
absl::StatusOr<std::unique_ptr<HttpServer>> ServeMetrics(const std::string& address, StatusServiceImpl* status,
                                                         std::function<bool()> serving);

// Every number of `status`, under the names of metric_table.h; each has the label `role`.
std::vector<prometheus::MetricFamily> ToMetricFamilies(const v1::StatusReply& status);

}  // namespace craftfleet::wire
