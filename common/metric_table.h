// Every metric that the programs tell, in their status and to Prometheus: names, units, meanings.

#ifndef CRAFTFLEET_COMMON_METRIC_TABLE_H_
#define CRAFTFLEET_COMMON_METRIC_TABLE_H_

#include <string>

#include <absl/strings/string_view.h>
#include <absl/types/span.h>

namespace craftfleet {

struct MetricInfo {
  absl::string_view name;  // in the status; the same in every process that has it
  bool counter = false;    // only grows while the process lives
  absl::string_view unit;  // "s", "bytes", "steps/s"; empty for plain counts
  absl::string_view help;  // one sentence
};

absl::Span<const MetricInfo> MetricTable();

// Of the status metric `name`; null: there is none.
const MetricInfo* FindMetric(absl::string_view name);

// What Prometheus calls it: craftfleet_NAME, with _seconds or _bytes for its unit and _total for a counter.
std::string PrometheusName(const MetricInfo& metric);

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_METRIC_TABLE_H_
