// WorkerRegistry: what status pages show.
#include <algorithm>
#include <iterator>
#include <tuple>
#include <utility>
#include <vector>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/strings/str_join.h>

#include "learner/scheduling/worker_registry.h"

namespace craftfleet {
namespace {

constexpr absl::Duration kCurrent = absl::Seconds(10);  // age of a summary
constexpr size_t kMaxNamed = 4;                         // fragments and tasks in a log line

}  // namespace

bool WorkerRegistry::IsShown(const Worker& worker, absl::Time now, WorkerInfo* info) const {
  info->health = HealthOf(worker, now);
  info->silent = now - worker.last_seen;
  const bool is_known = info->silent <= (info->health == Health::kLeft ? kRememberLeft : kRememberLost);
  const bool differs = worker.mismatch.has_value() && now - worker.mismatch->time <= kRememberLost;
  info->refused = !is_known && differs && !options_.build.allow_mixed;
  if (info->refused) {
    info->health = Health::kLost;
    info->silent = now - worker.mismatch->time;
  }
  info->summary_is_old = now - worker.summary_time > kCurrent;
  return is_known || info->refused;
}

WorkerRegistry::Glance WorkerRegistry::GlanceAt(const Worker& worker, const WorkerInfo& info) const {
  Glance glance = {worker.role, info.health};
  if (worker.draining) {
    const bool plays = worker.role == WorkerRole::kActor && worker.active;
    glance.drained = plays ? lanes_.PermitsOf(worker.name) == 0 : worker.empty;
  }
  if (info.health == Health::kOk && !info.summary_is_old) glance.summary = worker.summary;
  if (info.health == Health::kSlow) {
    glance.name = absl::StrFormat("%s (%.0f ms a step)", worker.address, worker.step_ms);
  }
  return glance;
}

std::string WorkerRegistry::WaitsFor() const {
  const MutexLock lock(&mu_);
  std::vector<std::string> waits;
  for (const LaneScheduler::Playing& playing : lanes_.BeingPlayed()) {
    waits.push_back(absl::StrFormat("fragment %d of lane %d (%s)", playing.permit.fragment, playing.permit.lane,
                                    absl::StrJoin(playing.actors, ", ", [](std::string* out, const auto& actor) {
                                      absl::StrAppendFormat(
                                          out, "actor %s for %s", actor.first,
                                          absl::FormatDuration(absl::Trunc(actor.second, absl::Seconds(1))));
                                    })));
  }
  for (std::string& task : evaluations_.BeingPlayed()) waits.push_back(std::move(task));
  const size_t more = waits.size() - std::min(waits.size(), kMaxNamed);
  waits.resize(waits.size() - more);
  return absl::StrCat(absl::StrJoin(waits, ", "), more == 0 ? "" : absl::StrFormat(" and %d more", more));
}

std::vector<WorkerRegistry::WorkerInfo> WorkerRegistry::Workers(size_t most, std::vector<Glance>* all) const {
  const MutexLock lock(&mu_);
  const absl::Time now = clock_->Now();
  std::vector<std::pair<const Worker*, WorkerInfo>> notable;
  std::vector<std::pair<const Worker*, WorkerInfo>> others;
  if (all != nullptr) all->reserve(workers_.size());
  for (const auto& [key, worker] : workers_) {
    WorkerInfo info;
    if (!IsShown(worker, now, &info)) continue;
    if (all != nullptr) all->push_back(GlanceAt(worker, info));
    const bool is_notable = info.health != Health::kOk || worker.draining || worker.mismatch.has_value();
    std::vector<std::pair<const Worker*, WorkerInfo>>& kind = is_notable ? notable : others;
    if (kind.size() < most) kind.emplace_back(&worker, std::move(info));
  }
  others.resize(std::min(others.size(), most - notable.size()));
  notable.insert(notable.end(), std::make_move_iterator(others.begin()), std::make_move_iterator(others.end()));
  std::sort(notable.begin(), notable.end(), [](const auto& a, const auto& b) {
    return std::tie(a.first->role, a.first->name) < std::tie(b.first->role, b.first->name);
  });
  std::vector<WorkerInfo> infos;
  for (auto& [worker, info] : notable) {
    info.worker = *worker;
    if (info.worker.mismatch.has_value() && now - info.worker.mismatch->time > kRememberLost) {
      info.worker.mismatch.reset();
    }
    if (worker->role == WorkerRole::kActor && worker->active) {
      info.play = lanes_.InfoOf(worker->name);
      info.listed = lists_.SizeOf(worker->name);
      info.servers = lists_.servers();
    }
    infos.push_back(std::move(info));
  }
  return infos;
}

}  // namespace craftfleet
