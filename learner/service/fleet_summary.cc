#include "learner/service/fleet_summary.h"

#include <map>
#include <utility>

#include <absl/strings/str_format.h>

#include "common/wire/status_service.h"
#include "learner/service/worker_page.h"

namespace craftfleet {

FleetView ViewFleet(const Work& trainer, const std::vector<WorkerRegistry::WorkerInfo>& workers) {
  using Health = WorkerRegistry::Health;
  FleetView view;
  view.learner = trainer.times;
  view.early = trainer.times[Activity::kUpdate] == 0;  // times cover at least one whole iteration
  for (const WorkerRegistry::WorkerInfo& info : workers) {
    const Worker& worker = info.worker;
    const bool ok = info.health == Health::kOk || info.health == Health::kSlow;
    if (info.health == Health::kSlow) {
      view.slow_env_servers.push_back(absl::StrFormat("%s (%.0f ms a step)", worker.address, worker.step_ms));
    }
    if (worker.role == WorkerRole::kEnvServer) {
      view.env_servers += ok ? 1 : 0;
      view.drained_env_servers += ok && info.IsDrained() ? 1 : 0;
      view.lost_env_servers += info.health == Health::kLost || info.health == Health::kNotAnswering ? 1 : 0;
    } else if (ok) {
      ++view.actors;
      view.drained_actors += info.IsDrained() ? 1 : 0;
      if (info.health != Health::kOk || info.summary_is_old || worker.summary == nullptr) continue;
      view.steps_per_second += worker.summary->steps_per_second();
      view.actors_times.Add(wire::TimesOf(*worker.summary));
    }
  }
  return view;
}

void CountWorkers(const std::vector<WorkerRegistry::WorkerInfo>& workers, v1::FleetSummary* summary) {
  std::map<std::pair<WorkerRole, WorkerRegistry::Health>, int> counts;
  for (const WorkerRegistry::WorkerInfo& info : workers) ++counts[{info.worker.role, info.health}];
  for (const auto& [kind, number] : counts) {
    v1::WorkerCount* const count = summary->add_workers();
    count->set_role(RoleName(kind.first));
    count->set_health(ToProto(kind.second));
    count->set_number(number);
  }
}

namespace {

v1::FleetSummary::RunState RunStateOf(const FleetView& view) {
  if (view.finished) return v1::FleetSummary::COMPLETE;
  if (view.evaluating) return v1::FleetSummary::EVALUATING;
  return view.paused ? v1::FleetSummary::PAUSED : v1::FleetSummary::TRAINING;
}

}  // namespace

v1::FleetSummary SummarizeFleet(const FleetView& view) {
  v1::FleetSummary summary;
  wire::AddShares(FleetTimes(view), summary.mutable_times());
  const Bottleneck bottleneck = FindBottleneck(view);
  summary.set_bottleneck(bottleneck.part);
  summary.set_advice(bottleneck.advice);
  summary.set_run_state(RunStateOf(view));
  return summary;
}

}  // namespace craftfleet
