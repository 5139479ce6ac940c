#include "common/wire/metrics.h"

#include <prometheus/text_serializer.h>

#include <map>
#include <utility>

#include <absl/strings/match.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>

#include "common/base/check.h"
#include "common/base/status_macros.h"
#include "common/base/status_prefix.h"
#include "common/telemetry/activity_meter.h"
#include "common/telemetry/log.h"
#include "common/telemetry/metric_table.h"
#include "common/wire/channel.h"

namespace craftfleet::wire {
namespace {

using prometheus::ClientMetric;
using prometheus::MetricFamily;
using prometheus::MetricType;

constexpr char kPath[] = "/metrics";
constexpr char kContentType[] = "text/plain; version=0.0.4; charset=utf-8";

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
  std::map<std::pair<std::string, v1::Peer::Health>, int> workers;
  for (const v1::WorkerCount& count : status.fleet().workers()) {
    workers[{count.role(), count.health()}] += count.number();
  }
  for (const char* worker : {"actor", "envserver"}) {
    families->Add("workers", workers[{worker, v1::Peer::OK}], {{"worker", worker}, {"state", "ok"}});
    families->Add("workers", workers[{worker, v1::Peer::LOST}], {{"worker", worker}, {"state", "lost"}});
    families->Add("workers", workers[{worker, v1::Peer::NOT_ANSWERING}],
                  {{"worker", worker}, {"state", "not_answering"}});
    families->Add("workers", workers[{worker, v1::Peer::SLOW}], {{"worker", worker}, {"state", "slow"}});
  }
}

}  // namespace

absl::Status CheckMetricsAddress(absl::string_view address, bool insecure) {
  if (address.empty()) return absl::OkStatus();
  CRAFTFLEET_RETURN_IF_ERROR(CheckAddress("metrics_listen", address));
  if (absl::StartsWith(address, kUnix)) {
    return absl::InvalidArgumentError(absl::StrFormat("--metrics_listen=%s, want HOST:PORT", address));
  }
  if (!insecure && !IsLoopback(address)) {
    return absl::InvalidArgumentError(
        absl::StrFormat("--metrics_listen=%s reaches beyond this host, where anyone could read the metrics, which are "
                        "plain HTTP: listen on 127.0.0.1, or add --metrics_insecure if the network is trusted",
                        address));
  }
  return absl::OkStatus();
}

absl::StatusOr<std::unique_ptr<HttpServer>> ServeMetrics(const std::string& address, StatusServiceImpl* status,
                                                         std::function<bool()> serving) {
  if (address.empty()) return nullptr;
  const auto respond = [status,
                        serving = std::move(serving)](const HttpServer::Request& request) -> HttpServer::Response {
    if (request.path() == kPath) {
      return {200, kContentType, prometheus::TextSerializer().Serialize(ToMetricFamilies(status->Snapshot()))};
    }
    if (request.path() != "/healthz") return {404, kContentType, "metrics are at /metrics, health at /healthz\n"};
    if (serving()) return {200, kContentType, "serving\n"};
    return {503, kContentType, "not serving\n"};
  };
  CRAFTFLEET_ASSIGN_OR_RETURN(std::unique_ptr<HttpServer> server,
                              WithPrefix("--metrics_listen", HttpServer::Create({address}, respond)));
  const std::string url = absl::StrCat("http://", server->address(), kPath);
  status->SetMetricsAddress(url);
  LogInfo("metrics on %s", url);
  return server;
}

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
