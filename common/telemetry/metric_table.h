// Every metric that the programs report, in their status and to Prometheus: name, unit and meaning.

#pragma once

#include <string>

#include <absl/strings/string_view.h>
#include <absl/types/span.h>

namespace craftfleet {

struct MetricInfo {
  absl::string_view name;  // in the status; the same in every process that has it
  bool counter = false;    // never decreases during the life of the process
  absl::string_view unit;  // "s", "bytes", "steps/s"; empty for plain counts
  absl::string_view help;  // one sentence
};

absl::Span<const MetricInfo> MetricTable();

// Values of the label `part` of fleet_bottleneck, the part that limits the fleet's speed. "actors" and "environment
// servers" mean that there are none of them; "none" means that no bottleneck is known.
inline constexpr absl::string_view kBottleneckParts[] = {"none",        "actors", "environment servers", "learner",
                                                         "environment", "wire",   "inference",           "permits"};

// The entry of the metric `name`; null if it is unknown.
const MetricInfo* FindMetric(absl::string_view name);

// The metric's name in Prometheus: craftfleet_NAME, with _seconds or _bytes for its unit and _total for a counter.
std::string PrometheusName(const MetricInfo& metric);

}  // namespace craftfleet
