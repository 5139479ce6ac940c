#include "learner/scheduling/worker_table.h"

#include <algorithm>
#include <utility>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/strings/str_join.h>

#include "common/base/status_macros.h"

namespace craftfleet {
namespace {

constexpr absl::Time kNever = absl::InfinitePast();
constexpr absl::Duration kPruneEvery = absl::Seconds(1);

absl::string_view NameOf(WorkerRole role) { return role == WorkerRole::kActor ? "actor" : "environment server"; }

absl::Status NotTheOwner(absl::string_view what, absl::string_view name, absl::Duration lapse) {
  return absl::PermissionDeniedError(
      absl::StrFormat("%s \"%s\" belongs to another certificate: the name is free %s after its owner's last "
                      "call",
                      what, name, absl::FormatDuration(lapse)));
}

}  // namespace

Worker* WorkerTable::Find(WorkerRole role, absl::string_view name) {
  const auto entry = workers_.find(Key(role, name));
  return entry == workers_.end() ? nullptr : &entry->second;
}

Worker* WorkerTable::FindActiveActor(absl::string_view name) {
  Worker* const worker = Find(WorkerRole::kActor, name);
  return worker != nullptr && worker->active ? worker : nullptr;
}

Worker* WorkerTable::FindServer(absl::string_view address) {
  const auto placed = servers_.find(address);
  return placed == servers_.end() ? nullptr : placed->second;
}

absl::StatusOr<Worker*> WorkerTable::FindActive(absl::string_view name_or_address) {
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
      "no worker \"%s\" has joined or registered; there are: %s (environment servers register with --learner)",
      name_or_address, names.empty() ? "none" : absl::StrJoin(names, ", ")));
}

Worker* WorkerTable::Record(WorkerRole role, absl::string_view name) {
  const auto [entry, is_new] = workers_.try_emplace(Key(role, name));
  if (is_new) {
    entry->second.role = role;
    entry->second.name = std::string(name);
  }
  return &entry->second;
}

bool WorkerTable::IsForfeit(WorkerRole role, absl::string_view name, const WorkerClient& client) const {
  const auto entry = workers_.find(Key(role, name));
  return entry != workers_.end() && entry->second.client.identity != client.identity && !IsOwned(entry->second);
}

absl::StatusOr<Worker*> WorkerTable::Own(WorkerRole role, absl::string_view name, const WorkerClient& client) {
  Worker* worker = Find(role, name);
  if (worker != nullptr && worker->client.identity != client.identity) {
    // An active actor has lanes: it must be removed first. Its name may have lapsed a moment ago.
    const bool is_playing = role == WorkerRole::kActor && worker->active;
    if (is_playing || IsOwned(*worker)) return NotTheOwner(NameOf(role), name, options_.name_lapse);
    Erase(worker);  // the record of another worker
    worker = nullptr;
  }
  if (worker == nullptr || worker->name_used == kNever) {
    if (clock_->Now() - pruned_ >= kPruneEvery) Prune();
    absl::Status room = CheckRoomForName(role, name, client);
    if (!room.ok()) {
      Prune();
      room = CheckRoomForName(role, name, client);
    }
    CRAFTFLEET_RETURN_IF_ERROR(room);
    worker = Record(role, name);
    worker->client = client;
  }
  worker->name_used = clock_->Now();
  return worker;
}

absl::Status WorkerTable::CheckRoomForName(WorkerRole role, absl::string_view name, const WorkerClient& client) const {
  size_t names = 0;
  int names_here = 0;
  for (const auto& [key, worker] : workers_) {
    if (worker.name_used == kNever || worker.client.identity != client.identity) continue;
    ++names;
    if (worker.client.host == client.host) ++names_here;
  }
  if (names >= kMaxNames) {
    return absl::ResourceExhaustedError(
        absl::StrFormat("%s \"%s\": the same certificate already has %d names, which is the most it may have",
                        NameOf(role), name, names));
  }
  if (names_here >= options_.max_names_per_client) {
    return absl::ResourceExhaustedError(
        absl::StrFormat("%s \"%s\": %s already has %d workers, the most that one client may have", NameOf(role), name,
                        client.Name(), names_here));
  }
  return absl::OkStatus();
}

absl::Status WorkerTable::CheckAddress(absl::string_view name, absl::string_view address, const WorkerClient& client) {
  const auto entry = servers_.find(address);
  if (entry == servers_.end() || entry->second->name == name) return absl::OkStatus();
  const Worker& other = *entry->second;
  if (!IsOwned(other) || other.client.identity == client.identity) return absl::OkStatus();
  return NotTheOwner("environment server at", address, options_.name_lapse);
}

bool WorkerTable::IsOwned(const Worker& worker) const { return clock_->Now() - worker.name_used < options_.name_lapse; }

void WorkerTable::Erase(Worker* worker) {
  if (worker->role == WorkerRole::kEnvServer) {
    RemoveServer(worker);
    const auto placed = servers_.find(worker->address);
    if (placed != servers_.end() && placed->second == worker) servers_.erase(placed);
  }
  workers_.erase(Key(worker->role, worker->name));
}

void WorkerTable::PlaceServer(Worker* server, absl::string_view address) {
  if (server->address != address) {
    const auto former = servers_.find(server->address);
    if (former != servers_.end() && former->second == server) {
      RemoveServer(server);
      servers_.erase(former);
    }
  }
  const auto placed = servers_.find(address);
  if (placed != servers_.end() && placed->second != server) {
    placed->second->active = false;  // replaced: lists keep the address
    Erase(placed->second);
  }
  // The record made from actors' reports on this address.
  Worker* const reported = Find(WorkerRole::kEnvServer, address);
  if (reported != nullptr && reported != server && reported->IsOnlyReported()) Erase(reported);
  server->address = std::string(address);
  server->active = true;
  servers_[server->address] = server;
  ListServer(*server);
}

void WorkerTable::RemoveServer(Worker* server) {
  if (!server->active) return;
  server->active = false;
  ListServer(*server);
}

void WorkerTable::ListServer(const Worker& server) {
  if (server.active && !server.draining) {
    lists_.PutServer(server.address, server.client);
  } else {
    lists_.RemoveServer(server.address);
  }
}

void WorkerTable::ExpireServers() {
  const absl::Time now = clock_->Now();
  for (const auto& [address, server] : servers_) {
    if (server->active && now - server->leased_from >= server->lease) RemoveServer(server);
  }
}

void WorkerTable::Prune() {
  const absl::Time now = clock_->Now();
  pruned_ = now;
  std::vector<Worker*> gone;
  std::vector<Worker*> unowned;
  for (auto& [key, worker] : workers_) {
    if (now - worker.name_used >= options_.name_lapse) worker.name_used = kNever;
    if (!worker.active && worker.name_used == kNever) unowned.push_back(&worker);
    if (worker.last_seen != kNever && HealthOf(worker) != WorkerHealth::kOk) gone.push_back(&worker);
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

void WorkerTable::NoteReport(Worker* worker, std::shared_ptr<const v1::ProcessSummary> summary) {
  worker->last_seen = clock_->Now();
  worker->own_report = worker->last_seen;
  worker->left = false;
  if (summary == nullptr) return;
  worker->summary = std::move(summary);
  worker->summary_time = worker->last_seen;
}

void WorkerTable::ForgetRefused() {
  std::vector<Worker*> differing;
  for (auto& [key, worker] : workers_) {
    if (worker.mismatch.has_value()) differing.push_back(&worker);
  }
  if (differing.size() <= kMaxRefused) return;
  (*std::min_element(differing.begin(), differing.end(), [](const Worker* a, const Worker* b) {
    return a->mismatch->time < b->mismatch->time;
  }))->mismatch.reset();
}

WorkerHealth WorkerTable::HealthOf(const Worker& worker) const {
  const absl::Time now = clock_->Now();
  if (worker.left) return WorkerHealth::kLeft;
  if (now - worker.not_answering < kRelayed) return WorkerHealth::kNotAnswering;
  if (now - worker.slow < kRelayed) return WorkerHealth::kSlow;
  // A server that is silent is shown as lost before it is no longer listed.
  const absl::Duration lease = worker.role == WorkerRole::kActor ? worker.lease : worker.lease * 5 / 8;
  const absl::Duration silence = worker.own_report == kNever ? kRelayed : std::max(actor_lease_, lease);
  return now - worker.last_seen < silence ? WorkerHealth::kOk : WorkerHealth::kLost;
}

}  // namespace craftfleet
