// The status endpoint of every process.

#pragma once

#include <functional>
#include <string>

#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>
#include <absl/time/time.h>

#include "common/base/mutex.h"
#include "common/telemetry/activity_meter.h"
#include "craftfleet/v1/status.grpc.pb.h"

namespace craftfleet::wire {

// The status of a process. Thread-safe if `fill` is.
class StatusServiceImpl final : public v1::StatusService::Service {
 public:
  // Fills in the fields that differ between programs, the summary above all.
  using Fill = std::function<void(v1::StatusReply*)>;

  StatusServiceImpl(absl::string_view role, Fill fill);

  // Of this process, as workers register with a learner: unique.
  const std::string& name() const { return name_; }
  // The current status, for this service and the metrics endpoint.
  v1::StatusReply Snapshot() const ABSL_LOCKS_EXCLUDED(mu_);
  // Includes the URL of the process's metrics in the status from now on.
  void SetMetricsAddress(absl::string_view address) ABSL_LOCKS_EXCLUDED(mu_);

  grpc::Status GetStatus(grpc::ServerContext* context, const v1::StatusRequest* request,
                         v1::StatusReply* reply) override;

 private:
  const std::string role_;
  const std::string name_;
  const Fill fill_;
  const absl::Time start_;

  mutable Mutex mu_;
  std::string metrics_address_ ABSL_GUARDED_BY(mu_);
};

// `reply` as JSON with every field, named as in status.proto; with `whitespace` on many lines.
absl::StatusOr<std::string> StatusJson(const v1::StatusReply& reply, bool whitespace);

// Adds a metric of MetricTable, with the unit listed there.
void AddMetric(absl::string_view name, double value, v1::StatusReply* reply);

// Fills in the fields that every process reports: memory and errors.
void FillUsage(v1::ProcessSummary* summary);

// Fills in rate, threads and times of a process: `total` work since the start, `recent` work, by `threads` threads.
void FillWork(const Work& total, const Work& recent, int threads, v1::ProcessSummary* summary);

// The process's time by activity within one second, summed over its threads.
ByActivity TimesOf(const v1::ProcessSummary& summary);

// Appends `shares` (0..1) to `times`, without seconds.
void AddShares(const ByActivity& shares, google::protobuf::RepeatedPtrField<v1::ActivityTime>* times);

}  // namespace craftfleet::wire
