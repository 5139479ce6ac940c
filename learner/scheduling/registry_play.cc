// WorkerRegistry: permits, lanes and evaluations.
#include <algorithm>
#include <utility>

#include <absl/strings/str_format.h>

#include "common/base/status_macros.h"
#include "learner/scheduling/worker_registry.h"

namespace craftfleet {
namespace {

absl::Status NotKnown(absl::string_view actor) {
  return absl::AbortedError(absl::StrFormat("actor %s is unknown: join again", actor));
}

}  // namespace

absl::Status WorkerRegistry::Join(const WorkerClient& client, absl::string_view name, absl::string_view address,
                                  const WorkerBuild& build) {
  const MutexLock lock(&mu_);
  CRAFTFLEET_ASSIGN_OR_RETURN(Worker* const actor, Own(WorkerRole::kActor, name, client));
  if (!address.empty()) actor->address = std::string(address);
  CRAFTFLEET_RETURN_IF_ERROR(CheckBuild(build, actor));
  ExpireActors();
  actor->active = true;
  actor->leased_from = clock_->Now();
  actor->lease = ActorLease();
  NoteReport(actor, nullptr);
  lanes_.Add(actor);
  return absl::OkStatus();
}

absl::StatusOr<WorkerRegistry::PermitReply> WorkerRegistry::GetPermits(const PermitRequest& request) {
  const MutexLock lock(&mu_);
  PermitReply reply;
  CRAFTFLEET_RETURN_IF_ERROR(ReportAndRenew(request, &reply));
  changed_.WaitFor(&mu_, request.wait, [&]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) { return TryGrant(request, &reply); });
  return Complete(request, std::move(reply));
}

std::optional<absl::StatusOr<WorkerRegistry::PermitReply>> WorkerRegistry::StartPermits(const PermitRequest& request) {
  const MutexLock lock(&mu_);
  PermitReply reply;
  if (absl::Status status = ReportAndRenew(request, &reply); !status.ok()) return status;
  if (!TryGrant(request, &reply)) return std::nullopt;
  return Complete(request, std::move(reply));
}

std::optional<absl::StatusOr<WorkerRegistry::PermitReply>> WorkerRegistry::RetryPermits(const PermitRequest& request,
                                                                                        bool last) {
  const MutexLock lock(&mu_);
  PermitReply reply;
  if (!TryGrant(request, &reply) && !last) return std::nullopt;
  return Complete(request, std::move(reply));
}

absl::Status WorkerRegistry::ReportAndRenew(const PermitRequest& request, PermitReply* reply) {
  CRAFTFLEET_RETURN_IF_ERROR(Own(WorkerRole::kActor, request.actor, request.client).status());
  for (const LaneFailure& failure : request.failures) {
    lanes_.Refuse(request.actor, failure.lane, failure.fragment, failure.reason);
  }
  evaluations_.Renew(request.actor, request.evaluation, ActorLease());
  CRAFTFLEET_ASSIGN_OR_RETURN(reply->lost, RenewPlay(request));
  Worker* const actor = FindActor(request.actor);
  actor->stream = std::max(actor->stream, request.stream);
  return absl::OkStatus();
}

bool WorkerRegistry::TryGrant(const PermitRequest& request, PermitReply* reply) {
  if (FindActor(request.actor) == nullptr || closed_) return true;
  reply->granted = lanes_.Grant(request.actor);
  return !reply->granted.empty() || !reply->lost.empty() || finished_;
}

absl::StatusOr<WorkerRegistry::PermitReply> WorkerRegistry::Complete(const PermitRequest& request, PermitReply reply) {
  if (closed_) return absl::UnavailableError("the learner is stopping");
  Worker* const actor = FindActor(request.actor);
  if (actor == nullptr) return NotKnown(request.actor);
  if (request.is_cancelled != nullptr && request.is_cancelled()) return absl::CancelledError("the client disconnected");
  actor->leased_from = clock_->Now();
  NoteReport(actor, request.summary);
  for (const ServerReport& server : request.servers) {
    if (!server.answers) NoteUnusable(server.address, actor);
    // A server of the registry that an actor can't reach has left, or reports itself.
    if (!request.wants_servers || server.answers || server.hangs || server.slow) NoteServer(server);
  }
  reply.finished = finished_;
  reply.resting = lanes_.paused() || actor->draining;
  reply.wait = PollInterval();
  if (request.evaluates && request.evaluation == 0 && !reply.resting) {
    reply.evaluation = evaluations_.Take(request.actor, actor->lease, actor->client.Name());
  }
  AddServerList(request, actor, &reply);
  return reply;
}

void WorkerRegistry::SetObserver(Observer observer) {
  const MutexLock lock(&mu_);
  observer_ = std::move(observer);
}

void WorkerRegistry::Wake(absl::string_view actor) {
  changed_.NotifyAll();
  if (observer_ != nullptr) observer_(actor);
}

absl::StatusOr<std::vector<Permit>> WorkerRegistry::RenewPlay(const PermitRequest& request) {
  Worker* const actor = FindActor(request.actor);
  // A late renewal is accepted if no other actor has requested its lanes in the meantime.
  if (actor != nullptr && clock_->Now() - actor->leased_from <= 2 * actor->lease) {
    actor->leased_from = clock_->Now();
    actor->lease = ActorLease();
  }
  ExpireActors();
  absl::StatusOr<std::vector<Permit>> lost = NotKnown(request.actor);
  if (FindActor(request.actor) != nullptr) lost = lanes_.Renew(request.actor, request.active, request.capacity);
  WakeIfChanged();
  return lost;
}

absl::Duration WorkerRegistry::PollInterval() const {
  return std::clamp(absl::Seconds(lanes_.actors()) / kPollsPerSecond, kShortestPoll, kLongestPoll);
}

absl::Duration WorkerRegistry::ActorLease() const { return options_.lanes.lease + PollInterval() - kShortestPoll; }

void WorkerRegistry::RemoveActor(Worker* actor) {
  lanes_.Remove(actor->name);
  evaluations_.Renew(actor->name, 0, absl::ZeroDuration());
  lists_.RemoveActor(actor->name);
  actor->active = false;
  WakeIfChanged();
}

void WorkerRegistry::ExpireActors() {
  for (const std::string& name : lanes_.RemoveExpired()) {
    lists_.RemoveActor(name);
    Find(WorkerRole::kActor, name)->active = false;
  }
  WakeIfChanged();
}

void WorkerRegistry::OnConnectionLost(absl::string_view name, int64_t stream) {
  const MutexLock lock(&mu_);
  Worker* const actor = FindActor(name);
  if (actor == nullptr || actor->stream != stream) return;
  const absl::Duration rest = actor->lease - options_.lanes.comeback;
  actor->leased_from = std::min(actor->leased_from, clock_->Now() - rest);
  lanes_.NoteLease(*actor);
}

void WorkerRegistry::WakeIfChanged() {
  const LaneScheduler::Change change = lanes_.TakeChange();
  if (change.all) return Wake();
  for (const std::string& actor : change.actors) Wake(actor);
}

std::vector<LaneScheduler::ActorInfo> WorkerRegistry::Actors() const {
  const MutexLock lock(&mu_);
  return lanes_.Actors();
}

absl::StatusOr<LaneScheduler::Verdict> WorkerRegistry::Judge(const WorkerClient& client, absl::string_view name,
                                                             const Permit& fragment) {
  const MutexLock lock(&mu_);
  if (FindActor(name) == nullptr) return LaneScheduler::Verdict::kExpired;
  CRAFTFLEET_RETURN_IF_ERROR(Own(WorkerRole::kActor, name, client).status());
  return lanes_.Judge(name, fragment);
}

absl::StatusOr<LaneScheduler::Verdict> WorkerRegistry::Accept(absl::string_view name, const Permit& fragment,
                                                              const LaneSnapshot& snapshot, uint64_t digest) {
  const MutexLock lock(&mu_);
  const absl::StatusOr<LaneScheduler::Verdict> verdict = lanes_.Accept(name, fragment, snapshot, digest);
  const bool was_due =
      verdict.ok() && (*verdict == LaneScheduler::Verdict::kAccepted || *verdict == LaneScheduler::Verdict::kStale);
  if (was_due) FindActor(name)->leased_from = clock_->Now();
  WakeIfChanged();
  return verdict;
}

bool WorkerRegistry::Restore(const Permit& fragment, const LaneSnapshot& snapshot, uint64_t digest) {
  const MutexLock lock(&mu_);
  return lanes_.Restore(fragment, snapshot, digest);
}

bool WorkerRegistry::Counts(int lane, int64_t fragment, uint64_t digest) const {
  const MutexLock lock(&mu_);
  return lanes_.Counts(lane, fragment, digest);
}

absl::StatusOr<LaneSnapshot> WorkerRegistry::Snapshot(int lane, int64_t fragment) const {
  const MutexLock lock(&mu_);
  return lanes_.Snapshot(lane, fragment);
}

void WorkerRegistry::OpenIteration(int64_t last_fragment, int64_t policy_version) {
  const MutexLock lock(&mu_);
  lanes_.OpenIteration(last_fragment, policy_version);
  WakeIfChanged();
}

void WorkerRegistry::PublishVersion(int64_t policy_version) {
  const MutexLock lock(&mu_);
  lanes_.PublishVersion(policy_version);
  WakeIfChanged();
}

std::optional<std::vector<Arrival>> WorkerRegistry::TakeRollout() {
  const MutexLock lock(&mu_);
  return lanes_.TakeRollout();
}

void WorkerRegistry::RewindIterations(int iterations) {
  const MutexLock lock(&mu_);
  lanes_.RewindIterations(iterations);
}

bool WorkerRegistry::SetPaused(bool paused) {
  const MutexLock lock(&mu_);
  const bool before = lanes_.SetPaused(paused);
  WakeIfChanged();
  return before;
}

bool WorkerRegistry::paused() const {
  const MutexLock lock(&mu_);
  return lanes_.paused();
}

std::vector<LaneRecord> WorkerRegistry::Records() const {
  const MutexLock lock(&mu_);
  return lanes_.Records();
}

std::vector<LaneRecord> WorkerRegistry::StartRecords() const {
  const MutexLock lock(&mu_);
  return lanes_.StartRecords();
}

int WorkerRegistry::actors() const {
  const MutexLock lock(&mu_);
  return lanes_.actors();
}

int WorkerRegistry::permits() const {
  const MutexLock lock(&mu_);
  return lanes_.permits();
}

int64_t WorkerRegistry::lapsed() const {
  const MutexLock lock(&mu_);
  return lanes_.lapsed();
}

int64_t WorkerRegistry::resets() const {
  const MutexLock lock(&mu_);
  return lanes_.resets();
}

int64_t WorkerRegistry::differing() const {
  const MutexLock lock(&mu_);
  return lanes_.differing();
}

int64_t WorkerRegistry::dropped() const {
  const MutexLock lock(&mu_);
  return lanes_.dropped();
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
  changed_.WaitFor(&mu_, timeout, [this]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) { return lanes_.empty(); });
}

void WorkerRegistry::AddEvaluation(Evaluation evaluation) {
  const MutexLock lock(&mu_);
  evaluations_.Add(std::move(evaluation));
}

std::shared_ptr<const std::string> WorkerRegistry::EvaluationWeights(int64_t task) const {
  const MutexLock lock(&mu_);
  return evaluations_.Weights(task);
}

absl::Status WorkerRegistry::FinishEvaluation(absl::string_view actor, int64_t task,
                                              absl::Span<const Episode> episodes) {
  const MutexLock lock(&mu_);
  if (FindActor(actor) == nullptr) return NotKnown(actor);
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

void WorkerRegistry::PopEvaluation() {
  const MutexLock lock(&mu_);
  evaluations_.Pop();
}

std::vector<Evaluation> WorkerRegistry::PendingEvaluations() const {
  const MutexLock lock(&mu_);
  return evaluations_.Pending();
}

size_t WorkerRegistry::pending_evaluations() const {
  const MutexLock lock(&mu_);
  return evaluations_.pending();
}

}  // namespace craftfleet
