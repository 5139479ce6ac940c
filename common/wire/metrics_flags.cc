#include <string>

#include <absl/flags/flag.h>

#include "common/base/status_macros.h"
#include "common/process/flag_values.h"
#include "common/wire/metrics.h"

ABSL_FLAG(craftfleet::GivenAddress, metrics_listen, {},
          "address to serve Prometheus metrics on, at http://HOST:PORT/metrics, and health at /healthz; empty: none\n"
          "[any free port of this host, see the log; craftfleet train: none]");
ABSL_FLAG(bool, metrics_insecure, false,
          "allow --metrics_listen beyond this host; metrics are plain HTTP, readable by every client");

namespace craftfleet::wire {

absl::StatusOr<std::string> MetricsAddressFromFlags(absl::string_view by_default) {
  const std::string address = absl::GetFlag(FLAGS_metrics_listen).address.value_or(std::string(by_default));
  CRAFTFLEET_RETURN_IF_ERROR(CheckMetricsAddress(address, absl::GetFlag(FLAGS_metrics_insecure)));
  return address;
}

}  // namespace craftfleet::wire
