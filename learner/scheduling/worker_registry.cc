#include "learner/scheduling/worker_registry.h"

#include <algorithm>
#include <utility>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/strings/str_join.h>

#include "common/base/status_macros.h"

namespace craftfleet {
namespace {

constexpr absl::Duration kCurrent = absl::Seconds(10);  // age of a summary
constexpr size_t kMaxNamed = 4;                         // fragments and tasks in a log line

absl::Status NotKnown(absl::string_view actor) {
  return absl::AbortedError(absl::StrFormat("actor %s is unknown: join again", actor));
}

}  // namespace

WorkerRegistry::WorkerRegistry(const Options& options, std::vector<LaneRecord> lanes, Clock* clock)
    : options_(options),
      clock_(clock),
      first_generation_(absl::ToUnixMicros(clock->WallNow())),
      workers_(options.names, options.lanes.lease, first_generation_, clock),
      reports_(first_generation_, options.server_lease, &workers_, clock),
      lanes_(options.lanes, std::move(lanes), clock),
      evaluations_(clock),
      builds_(options.build) {}

// -- Membership.

absl::StatusOr<Worker*> WorkerRegistry::Own(WorkerRole role, absl::string_view name, const WorkerClient& client) {
  if (role == WorkerRole::kActor && workers_.IsForfeit(role, name, client)) RemoveActor(workers_.Find(role, name));
  return workers_.Own(role, name, client);
}

absl::Status WorkerRegistry::CheckBuild(const WorkerBuild& build, Worker* worker) {
  absl::Status status = builds_.Check(build, clock_->Now(), worker);
  if (worker->mismatch.has_value()) workers_.ForgetRefused();
  return status;
}

absl::Status WorkerRegistry::UseName(WorkerRole role, absl::string_view name, const WorkerClient& client) {
  const MutexLock lock(&mu_);
  return Own(role, name, client).status();
}

absl::Status WorkerRegistry::Join(const WorkerClient& client, absl::string_view name, absl::string_view address,
                                  const WorkerBuild& build) {
  const MutexLock lock(&mu_);
  CRAFTFLEET_ASSIGN_OR_RETURN(Worker* const actor, Own(WorkerRole::kActor, name, client));
  if (!address.empty()) actor->address = std::string(address);
  CRAFTFLEET_RETURN_IF_ERROR(CheckBuild(build, actor));
  ExpireActors();
  actor->active = true;
  actor->leased_from = clock_->Now();
  actor->lease = options_.lanes.lease;
  workers_.NoteReport(actor, nullptr);
  lanes_.table().Add(actor);
  return absl::OkStatus();
}

absl::Status WorkerRegistry::Announce(const WorkerClient& client, absl::string_view name, absl::string_view address,
                                      int lanes, const WorkerBuild& build,
                                      std::shared_ptr<const v1::ProcessSummary> summary) {
  const MutexLock lock(&mu_);
  workers_.ExpireServers();  // here too, since there may be no actor that requests servers
  CRAFTFLEET_ASSIGN_OR_RETURN(Worker* const server, Own(WorkerRole::kEnvServer, name, client));
  CRAFTFLEET_RETURN_IF_ERROR(workers_.CheckAddress(name, address, client));
  if (server->own_report == absl::InfinitePast()) server->address = std::string(address);
  CRAFTFLEET_RETURN_IF_ERROR(CheckBuild(build, server));
  workers_.PlaceServer(server, address);
  server->empty = server->draining && lanes == 0;
  server->leased_from = clock_->Now();
  server->lease = options_.server_lease;
  workers_.NoteReport(server, std::move(summary));
  return absl::OkStatus();
}

absl::Status WorkerRegistry::Leave(const WorkerClient& client, WorkerRole role, absl::string_view name,
                                   absl::string_view address) {
  const MutexLock lock(&mu_);
  if (workers_.Find(role, name) == nullptr) return absl::OkStatus();
  CRAFTFLEET_ASSIGN_OR_RETURN(Worker* const worker, Own(role, name, client));
  if (role == WorkerRole::kActor) {
    RemoveActor(worker);
  } else {
    CRAFTFLEET_RETURN_IF_ERROR(workers_.CheckAddress(name, address, client));
    workers_.RemoveServer(worker);
  }
  // Keep its mismatch: a refused worker leaves at once, and status must still show it.
  worker->draining = false;
  if (worker->last_seen != absl::InfinitePast()) {
    worker->left = true;
    worker->last_seen = clock_->Now();
  }
  worker->name_used = absl::InfinitePast();  // free
  Wake();
  return absl::OkStatus();
}

void WorkerRegistry::RemoveActor(Worker* actor) {
  lanes_.Remove(actor->name);
  evaluations_.Renew(actor->name, 0, absl::ZeroDuration());
  workers_.lists().RemoveActor(actor->name);
  actor->active = false;
  WakeIfChanged();
}

void WorkerRegistry::ExpireActors() {
  for (const std::string& name : lanes_.RemoveExpired()) {
    workers_.lists().RemoveActor(name);
    workers_.Find(WorkerRole::kActor, name)->active = false;
  }
  WakeIfChanged();
}

void WorkerRegistry::OnConnectionLost(absl::string_view name, int64_t stream) {
  const MutexLock lock(&mu_);
  Worker* const actor = workers_.FindActiveActor(name);
  if (actor == nullptr || actor->stream != stream) return;
  const absl::Duration rest = actor->lease - options_.lanes.comeback;
  actor->leased_from = std::min(actor->leased_from, clock_->Now() - rest);
}

absl::StatusOr<WorkerRegistry::WorkerId> WorkerRegistry::SetDraining(absl::string_view worker, bool draining) {
  const MutexLock lock(&mu_);
  workers_.ExpireServers();
  CRAFTFLEET_ASSIGN_OR_RETURN(Worker* const found, workers_.FindActive(worker));
  found->draining = draining;
  if (!draining) found->empty = false;
  if (found->role == WorkerRole::kActor) {
    lanes_.NoteDrain(found->name);
  } else {
    workers_.ListServer(*found);
  }
  Wake();
  return WorkerId{found->role, found->name};
}

bool WorkerRegistry::IsDrained(const WorkerId& id) {
  const MutexLock lock(&mu_);
  workers_.ExpireServers();
  const Worker* const worker = workers_.Find(id.role, id.name);
  if (id.role == WorkerRole::kEnvServer) return worker == nullptr || !worker->active || worker->empty;
  if (evaluations_.IsPlaying(id.name)) return false;
  if (worker == nullptr || !worker->active) return true;
  // The only actor stays active after its lease: actors expire when one calls. By now it could not renew it.
  if (clock_->Now() - worker->leased_from > 2 * worker->lease) return true;
  return worker->draining && lanes_.table().InfoOf(id.name).permits == 0;
}

void WorkerRegistry::Finish() {
  const MutexLock lock(&mu_);
  finished_ = true;
  Wake();
}

void WorkerRegistry::Close() {
  const MutexLock lock(&mu_);
  closed_ = true;
  Wake();
}

void WorkerRegistry::WaitUntilEmpty(absl::Duration timeout) {
  const MutexLock lock(&mu_);
  left_.WaitFor(&mu_, timeout, [this]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) { return lanes_.table().actors().empty(); });
}

// -- What status pages and logs show.

std::vector<WorkerRegistry::WorkerInfo> WorkerRegistry::Workers() const {
  const MutexLock lock(&mu_);
  std::vector<WorkerInfo> infos;
  for (const auto& [key, worker] : workers_.workers()) {
    if (std::optional<WorkerInfo> info = InfoOf(worker); info.has_value()) infos.push_back(*std::move(info));
  }
  return infos;
}

std::optional<WorkerRegistry::WorkerInfo> WorkerRegistry::InfoOf(const Worker& worker) const {
  const absl::Time now = clock_->Now();
  WorkerInfo info;
  info.health = workers_.HealthOf(worker);
  info.silent = now - worker.last_seen;
  const bool is_left = info.health == Health::kLeft;
  const bool is_known = info.silent <= (is_left ? WorkerTable::kRememberLeft : WorkerTable::kRememberLost);
  const bool differs = worker.mismatch.has_value() && now - worker.mismatch->time <= WorkerTable::kRememberLost;
  info.refused = !is_known && differs && !builds_.allow_mixed();
  if (!is_known && !info.refused) return std::nullopt;
  if (info.refused) {
    info.health = Health::kLost;
    info.silent = now - worker.mismatch->time;
  }
  info.summary_is_old = now - worker.summary_time > kCurrent;
  info.worker = worker;
  if (!differs) info.worker.mismatch.reset();
  if (worker.role == WorkerRole::kActor && worker.active) {
    info.play = lanes_.table().InfoOf(worker.name);
    info.evaluates = evaluations_.IsPlaying(worker.name);
    info.listed = workers_.lists().SizeOf(worker.name);
    info.servers = workers_.lists().servers();
  }
  return info;
}

std::string WorkerRegistry::WaitsFor() const {
  const MutexLock lock(&mu_);
  std::vector<std::string> waits;
  for (const LaneTable::Playing& playing : lanes_.table().BeingPlayed()) {
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

// -- Permits, fragments and evaluations.

std::optional<absl::StatusOr<WorkerRegistry::PermitReply>> WorkerRegistry::TryPermits(const PermitRequest& request,
                                                                                      bool first, bool last) {
  const MutexLock lock(&mu_);
  PermitReply reply;
  if (first) CRAFTFLEET_RETURN_IF_ERROR(ReportAndRenew(request, &reply));
  if (!TryGrant(request, &reply) && !last) return std::nullopt;
  return Complete(request, std::move(reply));
}

absl::Status WorkerRegistry::ReportAndRenew(const PermitRequest& request, PermitReply* reply) {
  CRAFTFLEET_RETURN_IF_ERROR(Own(WorkerRole::kActor, request.actor, request.client).status());
  for (const LaneFailure& failure : request.failures) {
    lanes_.reports().Add(request.actor, failure.lane, failure.fragment, failure.reason);
  }
  evaluations_.Renew(request.actor, request.evaluation, options_.lanes.lease);
  Worker* actor = workers_.FindActiveActor(request.actor);
  // A late renewal is accepted if no other actor has requested its lanes in the meantime.
  if (actor != nullptr && clock_->Now() - actor->leased_from <= 2 * actor->lease) actor->leased_from = clock_->Now();
  ExpireActors();
  actor = workers_.FindActiveActor(request.actor);
  if (actor == nullptr) return NotKnown(request.actor);
  reply->lost = lanes_.Renew(request.actor, request.active, request.capacity);
  actor->stream = std::max(actor->stream, request.stream);
  WakeIfChanged();
  return absl::OkStatus();
}

bool WorkerRegistry::TryGrant(const PermitRequest& request, PermitReply* reply) {
  if (workers_.FindActiveActor(request.actor) == nullptr || closed_) return true;
  reply->granted = lanes_.Grant(request.actor);
  return !reply->granted.empty() || !reply->lost.empty() || finished_;
}

absl::StatusOr<WorkerRegistry::PermitReply> WorkerRegistry::Complete(const PermitRequest& request, PermitReply reply) {
  if (closed_) return absl::UnavailableError("the learner is stopping");
  Worker* const actor = workers_.FindActiveActor(request.actor);
  if (actor == nullptr) return NotKnown(request.actor);
  if (request.is_cancelled != nullptr && request.is_cancelled()) return absl::CancelledError("the client disconnected");
  actor->leased_from = clock_->Now();
  workers_.NoteReport(actor, request.summary);
  for (const ServerReport& server : request.servers) {
    if (!server.answers) reports_.AddUnusable(server.address, actor);
    // A server of the registry that an actor can't reach has left, or reports itself.
    if (!request.wants_servers || server.answers || server.hangs || server.slow) reports_.Add(server);
  }
  reply.finished = finished_;
  const bool may_evaluate = !lanes_.assignment().paused() && !actor->draining;
  if (request.evaluates && request.evaluation == 0 && may_evaluate) {
    const bool is_late = lanes_.table().InfoOf(request.actor).late;
    reply.evaluation = evaluations_.Take(request.actor, actor->lease, actor->client.Name(), is_late);
  }
  if (!request.wants_servers) return reply;
  workers_.ExpireServers();
  reply.servers_generation = request.servers_generation;
  if (const auto list = reports_.NewList(request.servers_generation, actor); list.has_value()) {
    reply.servers_generation = list->generation;
    reply.servers.assign(list->addresses.begin(), list->addresses.end());
  }
  return reply;
}

void WorkerRegistry::SetObserver(Observer observer) {
  const MutexLock lock(&mu_);
  observer_ = std::move(observer);
}

void WorkerRegistry::Wake(absl::string_view actor) {
  left_.NotifyAll();
  if (observer_ != nullptr) observer_(actor);
}

void WorkerRegistry::WakeIfChanged() {
  const LaneTable::Change change = lanes_.table().TakeChange();
  if (change.all) return Wake();
  for (const std::string& actor : change.actors) Wake(actor);
}

absl::StatusOr<LaneScheduler::Verdict> WorkerRegistry::Judge(const WorkerClient& client, absl::string_view name,
                                                             const Permit& fragment) {
  const MutexLock lock(&mu_);
  if (workers_.FindActiveActor(name) == nullptr) return LaneScheduler::Verdict::kExpired;
  CRAFTFLEET_RETURN_IF_ERROR(Own(WorkerRole::kActor, name, client).status());
  return lanes_.Judge(name, fragment);
}

absl::StatusOr<LaneScheduler::Verdict> WorkerRegistry::Accept(absl::string_view name, const Permit& fragment,
                                                              const LaneSnapshot& snapshot, uint64_t digest) {
  const MutexLock lock(&mu_);
  const absl::StatusOr<LaneScheduler::Verdict> verdict = lanes_.Accept(name, fragment, snapshot, digest);
  const bool was_due =
      verdict.ok() && (*verdict == LaneScheduler::Verdict::kAccepted || *verdict == LaneScheduler::Verdict::kStale);
  if (was_due) workers_.FindActiveActor(name)->leased_from = clock_->Now();
  WakeIfChanged();
  return verdict;
}

absl::Status WorkerRegistry::FinishEvaluation(absl::string_view actor, int64_t task,
                                              absl::Span<const Episode> episodes) {
  const MutexLock lock(&mu_);
  if (workers_.FindActiveActor(actor) == nullptr) return NotKnown(actor);
  absl::Status status = evaluations_.Finish(actor, task, episodes);
  evaluated_.NotifyAll();
  return status;
}

std::optional<FinishedEvaluation> WorkerRegistry::FrontEvaluation(absl::Duration timeout) {
  const MutexLock lock(&mu_);
  evaluated_.WaitFor(&mu_, timeout,
                     [this]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) { return evaluations_.FrontFinished(); });
  return evaluations_.Front();
}

}  // namespace craftfleet
