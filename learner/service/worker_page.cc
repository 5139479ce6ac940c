#include "learner/service/worker_page.h"

#include <algorithm>
#include <string>
#include <utility>
#include <vector>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>

#include "common/wire/status_service.h"

namespace craftfleet {
namespace {

// Removes figures that only apply to active workers.
void ClearPresentWork(v1::ProcessSummary* summary) {
  summary->set_steps_per_second(0);
  summary->set_lanes(0);
  summary->clear_times();
}

// The worker's state as a text for people.
std::string StateOf(const WorkerRegistry::WorkerInfo& info, bool allow_mixed) {
  std::string state;
  const Worker& worker = info.worker;
  if (info.play.has_value()) {
    state = absl::StrFormat("%d permits, %d fragments accepted%s%s%s", info.play->permits, info.play->fragments,
                            info.listed < info.servers && info.listed > 0
                                ? absl::StrFormat(", %d of %d servers", info.listed, info.servers)
                                : "",
                            info.play->late ? ", late: others finish its fragments" : "",
                            !worker.draining   ? ""
                            : info.IsDrained() ? ", drained"
                                               : ", draining");
  } else if (worker.role == WorkerRole::kEnvServer && worker.active && worker.draining) {
    state = info.IsDrained() ? "drained" : "draining";
  }
  if (info.health == WorkerRegistry::Health::kSlow) {
    absl::StrAppendFormat(&state, "%sslow: %.0f ms a step", state.empty() ? "" : ", ", worker.step_ms);
  }
  if (worker.mismatch.has_value()) {
    absl::StrAppend(&state, state.empty() ? "" : "; ", allow_mixed ? "mixed" : "refused", ": another canary, build ",
                    worker.mismatch->build);
  }
  return state;
}

v1::Peer::Drain DrainOf(const WorkerRegistry::WorkerInfo& info) {
  if (!info.worker.draining) return v1::Peer::NO_DRAIN;
  return info.IsDrained() ? v1::Peer::DRAINED : v1::Peer::DRAINING;
}

// At most kMaxPeers of `workers`, in their order: first those that are lost, do not answer or are being drained.
std::vector<const WorkerRegistry::WorkerInfo*> Shown(const std::vector<WorkerRegistry::WorkerInfo>& workers) {
  std::vector<const WorkerRegistry::WorkerInfo*> shown;
  shown.reserve(workers.size());
  for (const WorkerRegistry::WorkerInfo& info : workers) shown.push_back(&info);
  if (shown.size() <= kMaxPeers) return shown;
  std::stable_partition(shown.begin(), shown.end(), [](const WorkerRegistry::WorkerInfo* info) {
    return info->health != WorkerRegistry::Health::kOk || info->worker.draining || info->worker.mismatch.has_value();
  });
  shown.resize(kMaxPeers);
  std::sort(shown.begin(), shown.end());  // of one array
  return shown;
}

}  // namespace

std::string RoleName(WorkerRole role) { return role == WorkerRole::kActor ? "actor" : "envserver"; }

v1::Peer::Health ToProto(WorkerRegistry::Health health) {
  switch (health) {
    case WorkerRegistry::Health::kOk:
      return v1::Peer::OK;
    case WorkerRegistry::Health::kLost:
      return v1::Peer::LOST;
    case WorkerRegistry::Health::kLeft:
      return v1::Peer::LEFT;
    case WorkerRegistry::Health::kNotAnswering:
      return v1::Peer::NOT_ANSWERING;
    case WorkerRegistry::Health::kSlow:
      return v1::Peer::SLOW;
  }
  return v1::Peer::HEALTH_UNSPECIFIED;
}

std::shared_ptr<const v1::ProcessSummary> KeepSummary(const v1::ProcessSummary& summary) {
  return summary.ByteSizeLong() == 0 ? nullptr : std::make_shared<v1::ProcessSummary>(summary);
}

ServerReport ToServerReport(const v1::Peer& server) {
  const bool slow = server.health() == v1::Peer::SLOW;
  return {server.address(),
          server.health() == v1::Peer::OK || slow,
          server.health() == v1::Peer::NOT_ANSWERING,
          KeepSummary(server.summary()),
          slow,
          server.step_ms()};
}

std::vector<WorkerRegistry::WorkerInfo> AddWorkers(const WorkerRegistry& registry, v1::StatusReply* reply) {
  std::vector<WorkerRegistry::WorkerInfo> all = registry.Workers();
  const bool allow_mixed = registry.builds()->allow_mixed();
  for (const WorkerRegistry::WorkerInfo* const shown : Shown(all)) {
    const WorkerRegistry::WorkerInfo& info = *shown;
    v1::Peer* const peer = reply->add_peers();
    peer->set_role(RoleName(info.worker.role));
    peer->set_name(info.worker.name);
    peer->set_address(info.worker.address);
    peer->set_health(ToProto(info.health));
    peer->set_last_seen_s(absl::ToDoubleSeconds(info.silent));
    if (info.health == WorkerRegistry::Health::kSlow) peer->set_step_ms(info.worker.step_ms);
    if (std::string state = StateOf(info, allow_mixed); !state.empty()) peer->set_state(std::move(state));
    if (const v1::Peer::Drain drain = DrainOf(info); drain != v1::Peer::NO_DRAIN) peer->set_drain(drain);
    if (info.refused) continue;
    if (info.worker.summary != nullptr) *peer->mutable_summary() = *info.worker.summary;
    const bool answers = info.health == WorkerRegistry::Health::kOk || info.health == WorkerRegistry::Health::kSlow;
    if (!answers || info.summary_is_old) ClearPresentWork(peer->mutable_summary());
  }
  wire::AddMetric("workers_mixed", static_cast<double>(registry.builds()->differing()), reply);
  return all;
}

}  // namespace craftfleet
