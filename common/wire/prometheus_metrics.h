// Converts a process's status to Prometheus metrics.

#pragma once

#include <prometheus/metric_family.h>

#include <vector>

#include "craftfleet/v1/status.pb.h"

namespace craftfleet::wire {

// Every number of `status`, under the names of metric_table.h; each has the label `role`.
std::vector<prometheus::MetricFamily> ToMetricFamilies(const v1::StatusReply& status);

}  // namespace craftfleet::wire
