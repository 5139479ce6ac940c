// The metrics of a status.

#pragma once

#include <absl/strings/string_view.h>

#include "craftfleet/v1/status.pb.h"

namespace craftfleet {

// The value of the metric `name`; -1: there is none.
inline double MetricOf(const v1::StatusReply& status, absl::string_view name) {
  for (const v1::Metric& metric : status.metrics()) {
    if (metric.name() == name) return metric.value();
  }
  return -1;
}

}  // namespace craftfleet
