#include "common/wire/prometheus_metrics.h"

#include <map>
#include <string>
#include <utility>

#include <absl/strings/string_view.h>

#include "common/base/check.h"
#include "common/telemetry/activity_meter.h"
#include "common/telemetry/metric_table.h"
#include "common/wire/status_service.h"

namespace craftfleet::wire {
namespace {

using prometheus::ClientMetric;
using prometheus::MetricFamily;
using prometheus::MetricType;

// Collects samples into families, in the order in which metrics first appear.
class Families {
 public:
  explicit Families(std::string role) : role_(std::move(role)) {}

  void Add(absl::string_view name, double value, std::vector<ClientMetric::Label> labels = {}) {
    const MetricInfo* info = FindMetric(name);
    CRAFTFLEET_CHECK(info != nullptr);
    const std::string key(name);
    const auto [place, is_new] = place_.try_emplace(key, families_.size());
    if (is_new) {
      MetricFamily& family = families_.emplace_back();
      family.name = PrometheusName(*info);
      family.help.assign(info->help.data(), info->help.size());
      family.type = info->counter ? MetricType::Counter : MetricType::Gauge;
    }
    ClientMetric& metric = families_[place->second].metric.emplace_back();
    metric.label = std::move(labels);
    metric.label.push_back({"role", role_});
    (info->counter ? metric.counter.value : metric.gauge.value) = value;
  }
  std::vector<MetricFamily> Take() { return std::move(families_); }

 private:
  const std::string role_;
  std::vector<MetricFamily> families_;
  std::map<std::string, size_t> place_;  // in families_, by name
};

void AddFleet(const v1::StatusReply& status, Families* families) {
  std::map<std::string, double> shares;
  for (const v1::ActivityTime& time : status.fleet().times()) shares[time.activity()] = time.share();
  for (const Activity activity : kActivities) {
    const std::string name(ActivityName(activity));
    families->Add("fleet_time_share", shares[name], {{"activity", name}});
  }
  // All of them each time, so that a series goes back to 0.
  for (const absl::string_view part : kBottleneckParts) {
    const std::string name(part);
    families->Add("fleet_bottleneck", status.fleet().bottleneck() == name ? 1 : 0, {{"part", name}});
  }
  std::map<std::pair<std::string, v1::Peer::Health>, int> workers = WorkersOf(status);
  for (const char* worker : {"actor", "envserver"}) {
    families->Add("workers", workers[{worker, v1::Peer::OK}], {{"worker", worker}, {"state", "ok"}});
    families->Add("workers", workers[{worker, v1::Peer::LOST}], {{"worker", worker}, {"state", "lost"}});
    families->Add("workers", workers[{worker, v1::Peer::NOT_ANSWERING}],
                  {{"worker", worker}, {"state", "not_answering"}});
    families->Add("workers", workers[{worker, v1::Peer::SLOW}], {{"worker", worker}, {"state", "slow"}});
  }
}

}  // namespace

std::vector<MetricFamily> ToMetricFamilies(const v1::StatusReply& status) {
  Families families(status.role());
  families.Add("info", 1, {{"name", status.name()}, {"version", status.version()}, {"run_id", status.run_id()}});
  for (const v1::Metric& metric : status.metrics()) families.Add(metric.name(), metric.value());
  families.Add("threads", status.summary().threads());
  for (const v1::ActivityTime& time : status.summary().times()) {
    families.Add("activity_time", time.seconds(), {{"activity", time.activity()}});
    families.Add("time_share", time.share(), {{"activity", time.activity()}});
  }
  if (status.has_fleet()) AddFleet(status, &families);
  return families.Take();
}

}  // namespace craftfleet::wire
