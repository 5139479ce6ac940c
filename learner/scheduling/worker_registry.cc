#include "learner/scheduling/worker_registry.h"

#include <algorithm>
#include <iterator>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/strings/str_join.h>

#include "common/base/status_macros.h"

namespace craftfleet {
namespace {

constexpr absl::Time kNever = absl::InfinitePast();

absl::string_view NameOf(WorkerRole role) { return role == WorkerRole::kActor ? "actor" : "environment server"; }

absl::Status NotTheOwner(absl::string_view what, absl::string_view name, absl::Duration lapse) {
  return absl::PermissionDeniedError(
      absl::StrFormat("%s \"%s\" belongs to another certificate or token: the name is free %s after its owner's last "
                      "call",
                      what, name, absl::FormatDuration(lapse)));
}

}  // namespace

WorkerRegistry::WorkerRegistry(const Options& options, std::vector<LaneRecord> lanes, Clock* clock)
    : options_(options),
      clock_(clock),
      start_(clock->Now()),
      first_generation_(absl::ToUnixMicros(clock->WallNow())),
      lists_(first_generation_),
      lanes_(options.lanes, std::move(lanes), clock),
      evaluations_(clock),
      builds_(options.build) {}

Worker* WorkerRegistry::Find(WorkerRole role, absl::string_view name) {
  const auto entry = workers_.find(Key(role, name));
  return entry == workers_.end() ? nullptr : &entry->second;
}

Worker* WorkerRegistry::FindActor(absl::string_view name) {
  Worker* const worker = Find(WorkerRole::kActor, name);
  return worker != nullptr && worker->active ? worker : nullptr;
}

absl::StatusOr<Worker*> WorkerRegistry::FindActive(absl::string_view name_or_address) {
  std::vector<std::string> names;
  std::vector<Worker*> there;  // workers say themselves at which address they are
  for (auto& [key, worker] : workers_) {
    if (!worker.active) continue;
    if (worker.name == name_or_address) return &worker;
    if (worker.address == name_or_address) there.push_back(&worker);
    names.push_back(worker.name);
  }
  if (there.size() == 1) return there[0];
  if (there.size() > 1) {
    return absl::NotFoundError(absl::StrFormat(
        "%d workers say that they are at %s: name one of %s", there.size(), name_or_address,
        absl::StrJoin(there, ", ",
                      [](std::string* out, const Worker* worker) { absl::StrAppend(out, worker->name); })));
  }
  return absl::NotFoundError(absl::StrFormat(
      "no worker \"%s\" has joined or registered; there are: %s", name_or_address,
      names.empty() ? "none (environment servers register with --learner)" : absl::StrJoin(names, ", ")));
}

Worker* WorkerRegistry::Record(WorkerRole role, absl::string_view name) {
  const auto [entry, is_new] = workers_.try_emplace(Key(role, name));
  if (is_new) {
    entry->second.role = role;
    entry->second.name = std::string(name);
  }
  return &entry->second;
}

absl::StatusOr<Worker*> WorkerRegistry::Own(WorkerRole role, absl::string_view name, const WorkerClient& client) {
  Worker* worker = Find(role, name);
  bool has_owner = worker != nullptr && worker->name_used != kNever;
  if (worker != nullptr && worker->client.identity != client.identity) {
    if (IsOwned(*worker)) return NotTheOwner(NameOf(role), name, options_.name_lapse);
    if (role == WorkerRole::kActor) RemoveActor(worker);
    Erase(worker);  // the record of another worker
    has_owner = false;
  }
  if (!has_owner) {
    PruneSometimes();
    absl::Status counted = CountName(role, name, client);
    if (!counted.ok()) {
      Prune();
      counted = CountName(role, name, client);
    }
    CRAFTFLEET_RETURN_IF_ERROR(counted);
    worker = Record(role, name);
    worker->client = client;
  }
  worker->name_used = clock_->Now();
  return worker;
}

absl::Status WorkerRegistry::CountName(WorkerRole role, absl::string_view name, const WorkerClient& client) {
  size_t& names = names_of_[client.identity];
  if (names >= kMaxNames) {
    return absl::ResourceExhaustedError(
        absl::StrFormat("%s \"%s\": the same certificate or token already has %d names, which is the most it may have",
                        NameOf(role), name, names));
  }
  int& names_here = names_from_[{client.identity, client.host}];
  if (names_here >= options_.max_names_per_client) {
    return absl::ResourceExhaustedError(
        absl::StrFormat("%s \"%s\": %s already has %d workers, the most that --max_connections_per_client lets it have",
                        NameOf(role), name, client.Name(), names_here));
  }
  ++names;
  ++names_here;
  return absl::OkStatus();
}

absl::Status WorkerRegistry::CheckAddress(absl::string_view name, absl::string_view address,
                                          const WorkerClient& client) {
  const auto entry = servers_.find(address);
  if (entry == servers_.end() || entry->second->name == name) return absl::OkStatus();
  const Worker& other = *entry->second;
  if (!IsOwned(other) || other.client.identity == client.identity) return absl::OkStatus();
  return NotTheOwner("environment server at", address, options_.name_lapse);
}

bool WorkerRegistry::IsOwned(const Worker& worker) const {
  return clock_->Now() - worker.name_used < options_.name_lapse;
}

void WorkerRegistry::ReleaseName(Worker* worker) {
  if (worker->name_used == kNever) return;
  const auto names = names_of_.find(worker->client.identity);
  if (--names->second == 0) names_of_.erase(names);
  const auto names_here = names_from_.find({worker->client.identity, worker->client.host});
  if (--names_here->second == 0) names_from_.erase(names_here);
  worker->name_used = kNever;
}

void WorkerRegistry::Erase(Worker* worker) {
  if (worker->role == WorkerRole::kEnvServer) {
    RemoveServer(worker);
    const auto placed = servers_.find(worker->address);
    if (placed != servers_.end() && placed->second == worker) servers_.erase(placed);
  }
  ReleaseName(worker);
  if (worker->reported) --reported_;
  workers_.erase(Key(worker->role, worker->name));
}

void WorkerRegistry::PruneSometimes() {
  if (++added_ >= workers_.size() / kPruneParts || clock_->Now() - pruned_ >= kPruneEvery) Prune();
}

void WorkerRegistry::Prune() {
  const absl::Time now = clock_->Now();
  added_ = 0;
  pruned_ = now;
  std::vector<Worker*> gone;
  std::vector<Worker*> unowned;
  for (auto& [key, worker] : workers_) {
    if (now - worker.name_used >= options_.name_lapse) ReleaseName(&worker);
    if (!worker.active && worker.name_used == kNever) unowned.push_back(&worker);
    if (worker.last_seen != kNever && HealthOf(worker) != Health::kOk) gone.push_back(&worker);
    if (worker.mismatch.has_value() && now - worker.mismatch->time > kRememberLost) worker.mismatch.reset();
  }
  std::sort(gone.begin(), gone.end(), [](const Worker* a, const Worker* b) { return a->last_seen < b->last_seen; });
  for (size_t i = 0; i < gone.size(); ++i) {
    if (now - gone[i]->last_seen <= kRememberLost && gone.size() - i <= kMaxGone) break;
    gone[i]->last_seen = kNever;
    gone[i]->summary.reset();
  }
  for (Worker* const worker : unowned) {
    if (worker->last_seen == kNever && !worker->mismatch.has_value()) Erase(worker);
  }
}

absl::Status WorkerRegistry::CheckBuild(const WorkerBuild& build, Worker* worker) {
  absl::Status status = builds_.Check(build, clock_->Now(), worker);
  if (!worker->mismatch.has_value()) return status;
  std::vector<Worker*> differing;
  for (auto& [key, other] : workers_) {
    if (other.mismatch.has_value()) differing.push_back(&other);
  }
  if (differing.size() > kMaxRefused) {
    (*std::min_element(differing.begin(), differing.end(), [](const Worker* a, const Worker* b) {
      return a->mismatch->time < b->mismatch->time;
    }))->mismatch.reset();
  }
  return status;
}

WorkerRegistry::Health WorkerRegistry::HealthOf(const Worker& worker, absl::Time now) const {
  if (worker.left) return Health::kLeft;
  if (now - worker.not_answering < kRelayed) return Health::kNotAnswering;
  if (now - worker.slow < kRelayed) return Health::kSlow;
  // A server that is silent is shown as lost before it is no longer listed.
  const absl::Duration lease = worker.role == WorkerRole::kActor ? worker.lease : worker.lease * 5 / 8;
  const absl::Duration silence = worker.own_report == kNever ? kRelayed : std::max(options_.lanes.lease, lease);
  return now - worker.last_seen < silence ? Health::kOk : Health::kLost;
}

void WorkerRegistry::NoteReport(Worker* worker, std::shared_ptr<const v1::ProcessSummary> summary) {
  worker->last_seen = clock_->Now();
  worker->own_report = worker->last_seen;
  worker->left = false;
  if (summary == nullptr) return;
  worker->summary = std::move(summary);
  worker->summary_time = worker->last_seen;
}

absl::Status WorkerRegistry::UseName(WorkerRole role, absl::string_view name, const WorkerClient& client) {
  const MutexLock lock(&mu_);
  return Own(role, name, client).status();
}

absl::Status WorkerRegistry::Leave(const WorkerClient& client, WorkerRole role, absl::string_view name,
                                   absl::string_view address) {
  const MutexLock lock(&mu_);
  if (Find(role, name) == nullptr) return absl::OkStatus();
  CRAFTFLEET_ASSIGN_OR_RETURN(Worker* const worker, Own(role, name, client));
  if (role == WorkerRole::kEnvServer) CRAFTFLEET_RETURN_IF_ERROR(CheckAddress(name, address, client));
  if (role == WorkerRole::kActor) {
    RemoveActor(worker);
  } else {
    RemoveServer(worker);
  }
  // Keep its mismatch: a refused worker leaves at once, and status must still show it.
  worker->draining = false;
  if (worker->last_seen != kNever) {
    worker->left = true;
    worker->last_seen = clock_->Now();
  }
  ReleaseName(worker);
  Wake();
  return absl::OkStatus();
}

absl::StatusOr<WorkerRegistry::WorkerId> WorkerRegistry::Drain(absl::string_view name_or_address) {
  const MutexLock lock(&mu_);
  ExpireServers();
  CRAFTFLEET_ASSIGN_OR_RETURN(Worker* const worker, FindActive(name_or_address));
  if (worker->role == WorkerRole::kActor) {
    worker->draining = true;
    lanes_.NoteDrain(worker->name);
    WakeIfChanged();
  } else {
    worker->draining = true;
    ListServer(*worker);
  }
  return WorkerId{worker->role, worker->name};
}

absl::StatusOr<WorkerRegistry::WorkerId> WorkerRegistry::Undrain(absl::string_view name_or_address) {
  const MutexLock lock(&mu_);
  ExpireServers();
  CRAFTFLEET_ASSIGN_OR_RETURN(Worker* const worker, FindActive(name_or_address));
  worker->draining = false;
  worker->empty = false;
  if (worker->role == WorkerRole::kActor) {
    lanes_.NoteDrain(worker->name);
  } else {
    ListServer(*worker);
  }
  Wake();
  return WorkerId{worker->role, worker->name};
}

bool WorkerRegistry::IsDrained(const WorkerId& id) {
  const MutexLock lock(&mu_);
  ExpireServers();
  const Worker* const worker = Find(id.role, id.name);
  if (id.role == WorkerRole::kEnvServer) return worker == nullptr || !worker->active || worker->empty;
  const bool has_permits = worker != nullptr && worker->active && (!worker->draining || lanes_.PermitsOf(id.name) > 0);
  return !has_permits && !evaluations_.IsPlaying(id.name);
}

std::string WorkerRegistry::GameCanary() const {
  const MutexLock lock(&mu_);
  return builds_.GameCanary();
}

int64_t WorkerRegistry::mixed() const {
  const MutexLock lock(&mu_);
  return builds_.differing();
}

}  // namespace craftfleet
