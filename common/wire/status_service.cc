#include "common/wire/status_service.h"

#include <optional>
#include <utility>

#include <google/protobuf/util/json_util.h>

#include "common/base/check.h"
#include "common/base/clock.h"
#include "common/base/printable.h"
#include "common/process/version.h"
#include "common/process/worker_name.h"
#include "common/telemetry/gpu_usage.h"
#include "common/telemetry/log.h"
#include "common/telemetry/metric_table.h"
#include "common/telemetry/process_usage.h"
#include "common/wire/request_check.h"

namespace craftfleet::wire {

StatusServiceImpl::StatusServiceImpl(absl::string_view role, Fill fill)
    : role_(role), name_(UniqueWorkerName()), fill_(std::move(fill)), start_(SteadyNow()) {}

v1::StatusReply StatusServiceImpl::Snapshot() const {
  v1::StatusReply reply;
  reply.set_role(role_);
  reply.set_name(name_);
  reply.set_version(BuildId());
  reply.set_uptime_s(absl::ToDoubleSeconds(SteadyNow() - start_));
  fill_(&reply);
  const v1::ProcessSummary& summary = reply.summary();
  AddMetric("steps_per_second", summary.steps_per_second(), &reply);
  AddMetric("lanes", summary.lanes(), &reply);
  if (role_ == "learner" || role_ == "actor") {
    AddMetric("policy_version", static_cast<double>(summary.policy_version()), &reply);
  }
  AddMetric("uptime", reply.uptime_s(), &reply);
  const ProcessUsage usage = ReadProcessUsage();
  AddMetric("cpu_time", usage.cpu_seconds, &reply);
  AddMetric("resident_memory", static_cast<double>(summary.memory_bytes()), &reply);
  if (!summary.gpu().empty()) {
    AddMetric("gpu_memory", static_cast<double>(summary.gpu_memory_bytes()), &reply);
    AddMetric("gpu_memory_size", static_cast<double>(summary.gpu_memory_size_bytes()), &reply);
    AddMetric("gpu_utilization", summary.gpu_utilization(), &reply);
  }
  AddMetric("open_files", static_cast<double>(usage.open_files), &reply);
  AddMetric("log_warnings", static_cast<double>(CountLogged().warnings), &reply);
  AddMetric("log_errors", static_cast<double>(summary.errors()), &reply);
  const MutexLock lock(&mu_);
  reply.set_metrics_address(metrics_address_);
  return reply;
}

void StatusServiceImpl::SetMetricsAddress(absl::string_view address) {
  const MutexLock lock(&mu_);
  metrics_address_.assign(address.data(), address.size());
}

grpc::Status StatusServiceImpl::GetStatus(grpc::ServerContext* /*context*/, const v1::StatusRequest* /*request*/,
                                          v1::StatusReply* reply) {
  *reply = Snapshot();
  return grpc::Status::OK;
}

absl::StatusOr<std::string> StatusJson(const v1::StatusReply& reply, bool whitespace) {
  google::protobuf::util::JsonPrintOptions options;
  options.add_whitespace = whitespace;
  options.always_print_primitive_fields = true;
  options.preserve_proto_field_names = true;
  std::string json;
  if (!google::protobuf::util::MessageToJsonString(reply, &json, options).ok()) {
    return absl::InternalError("the status has no JSON form");
  }
  return json;
}

void AddMetric(absl::string_view name, double value, v1::StatusReply* reply) {
  const MetricInfo* info = FindMetric(name);
  CRAFTFLEET_CHECK(info != nullptr);
  v1::Metric* metric = reply->add_metrics();
  metric->set_name(info->name.data(), info->name.size());
  metric->set_value(value);
  metric->set_unit(info->unit.data(), info->unit.size());
  metric->set_counter(info->counter);
}

void FillUsage(v1::ProcessSummary* summary) {
  summary->set_memory_bytes(ResidentMemoryBytes());
  const LogCounts logged = CountLogged();
  summary->set_errors(logged.errors);
  // Any other text, such as half a letter, makes the message invalid for its receiver.
  summary->set_last_error(Printable(logged.last_error.substr(0, kMaxReasonBytes)));
  if (const std::optional<GpuUsage> gpu = ReadGpuUsage(); gpu.has_value()) {
    summary->set_gpu(Printable(gpu->name).substr(0, kMaxGpuNameBytes));
    summary->set_gpu_memory_bytes(gpu->memory_bytes);
    summary->set_gpu_memory_size_bytes(gpu->memory_total_bytes);
    summary->set_gpu_utilization(gpu->utilization);
  }
}

void FillWork(const Work& total, const Work& recent, int threads, v1::ProcessSummary* summary) {
  summary->set_steps_per_second(recent.per_second);
  summary->set_threads(threads);
  const ByActivity shares = recent.times.Normalized();
  for (const Activity activity : kActivities) {
    if (total.times[activity] == 0) continue;
    v1::ActivityTime* time = summary->add_times();
    const std::string name(ActivityName(activity));
    time->set_activity(name);
    time->set_seconds(total.times[activity]);
    time->set_share(shares[activity]);
  }
}

ByActivity TimesOf(const v1::ProcessSummary& summary) {
  ByActivity times;
  for (const v1::ActivityTime& time : summary.times()) {
    const std::optional<Activity> activity = ActivityByName(time.activity());
    if (activity.has_value()) times[*activity] += time.share() * summary.threads();
  }
  return times;
}

void AddShares(const ByActivity& shares, google::protobuf::RepeatedPtrField<v1::ActivityTime>* times) {
  for (const Activity activity : kActivities) {
    if (shares[activity] == 0) continue;
    v1::ActivityTime* time = times->Add();
    const std::string name(ActivityName(activity));
    time->set_activity(name);
    time->set_share(shares[activity]);
  }
}

}  // namespace craftfleet::wire
