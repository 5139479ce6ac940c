#include "actor/actor.h"

#include <algorithm>
#include <functional>
#include <utility>

#include <absl/strings/str_format.h>

#include "actor/error_policy.h"
#include "actor/learner_replies.h"
#include "common/agent/agent_spec.h"
#include "common/agent/canary.h"
#include "common/agent/torch_setup.h"
#include "common/backoff.h"
#include "common/clock.h"
#include "common/log.h"
#include "common/status_macros.h"
#include "common/version.h"
#include "common/wire/protocol.h"
#include "common/wire/status_service.h"
#include "common/worker_name.h"

namespace craftfleet {
namespace {

constexpr absl::Duration kFirstRetry = absl::Milliseconds(250);
constexpr absl::Duration kLastRetry = absl::Seconds(2);
constexpr absl::Duration kSayAgain = absl::Seconds(10);  // between two lines about the same trouble
constexpr int kPollMs = 500;                             // long poll for permits; a tenth of the lease
constexpr size_t kServersTold = 8;                       // environment servers the learner is told of, each poll

bool IsAboutRights(const absl::Status& error) {
  return absl::IsPermissionDenied(error) || absl::IsUnauthenticated(error);
}

}  // namespace

absl::Status Actor::Options::Validate() const {
  if (threads < 1 || threads > 256) {
    return absl::InvalidArgumentError(absl::StrFormat("--threads=%d, want 1..256", threads));
  }
  if (capacity < 1 || capacity > 4096) {
    return absl::InvalidArgumentError(absl::StrFormat("--max_lanes=%d, want 1..4096", capacity));
  }
  if (!(env_timeout >= absl::Milliseconds(100) && env_timeout <= absl::Hours(1))) {
    return absl::InvalidArgumentError(
        absl::StrFormat("--env_timeout=%g, want 0.1..3600 s", absl::ToDoubleSeconds(env_timeout)));
  }
  return absl::OkStatus();
}

absl::StatusOr<std::unique_ptr<Actor>> Actor::Create(const Options& options) {
  CRAFTFLEET_RETURN_IF_ERROR(options.Validate());
  return std::unique_ptr<Actor>(new Actor(options));
}

Actor::Actor(const Options& options)
    : options_(options),
      name_(UniqueWorkerName()),
      learner_(options.learner),
      permits_(options.threads),
      sender_(&learner_, name_, &permits_) {}

Actor::~Actor() {
  Stop();
  StopLoops();
}

absl::Status Actor::Run(absl::string_view address) {
  address_ = std::string(address);
  absl::Status status = Join();
  if (status.ok()) status = StartLoops();
  if (status.ok()) status = KeepPermits();
  StopLoops();
  learner_.Leave(name_);
  MutexLock lock(&mu_);
  stopping_ = true;
  if (!loop_error_.ok()) return loop_error_;
  return status.code() == absl::StatusCode::kCancelled ? absl::OkStatus() : status;
}

void Actor::Stop() {
  bool joined = false;
  {
    MutexLock lock(&mu_);
    if (stopping_) return;
    stopping_ = true;
    changed_.NotifyAll();
    joined = !run_id_.empty();
  }
  // Before anything that takes time, so that others go on with its lanes at once.
  if (joined) learner_.Leave(name_);
  learner_.Cancel();
}

absl::Status Actor::Join() {
  v1::JoinRequest request;
  request.set_protocol_version(wire::kProtocolVersion);
  request.set_run_id(joined_.run_id());
  request.set_actor(name_);
  request.set_cpu(CpuDescription());
  request.set_address(address_);
  request.set_build(BuildId());
  request.set_only_ask(options_.set_up != nullptr && !set_up_);
  if (!request.only_ask()) {
    CRAFTFLEET_ASSIGN_OR_RETURN(*request.mutable_canary(), PolicyCanary());
  }
  Backoff backoff(kFirstRetry, kLastRetry);
  while (!stopping()) {
    absl::StatusOr<v1::JoinReply> reply = learner_.Join(request);
    if (reply.ok()) {
      if (const absl::Status status = CheckJoinReply(&*reply); !status.ok()) {
        return absl::DataLossError(absl::StrFormat("%s: its answer to join: %s", learner_.name(), status.message()));
      }
      if (request.only_ask()) {
        CRAFTFLEET_RETURN_IF_ERROR(options_.set_up(reply->config()));
        set_up_ = true;
        return Join();
      }
      was_welcome_ = true;
      joined_ = *std::move(reply);
      MutexLock lock(&mu_);
      run_id_ = joined_.run_id();
      LogInfo("%s: joined run %s, epoch %d", learner_.name(), joined_.run_id(), joined_.epoch());
      return absl::OkStatus();
    }
    // A learner that took us once knows us: what it says of our token then is what it says to a call.
    const Called called = was_welcome_ && IsAboutRights(reply.status()) ? Called::kPermits : Called::kJoin;
    if (!MayPass(called, reply.status())) return reply.status();
    Complain(reply.status());
    Pause(backoff.Next());
  }
  return absl::CancelledError("stopping");
}

absl::Status Actor::StartLoops() {
  const v1::RunConfig& config = joined_.config();
  CRAFTFLEET_ASSIGN_OR_RETURN(const AgentSpec spec, MakeAgentSpec(config));
  permits_.SetTile(config.tile());
  policies_ = std::make_unique<PolicySource>(&learner_, spec, config.tile());

  v1::SessionHello hello;
  hello.set_protocol_version(wire::kProtocolVersion);
  hello.set_run_id(joined_.run_id());
  hello.set_texture_digest(joined_.texture_digest());
  *hello.mutable_env() = config.env();
  hello.set_client(name_);
  hello.set_game_canary(joined_.game_canary());
  const int frame_bytes = static_cast<int>(spec.frame_bytes());
  v1::SessionHello probe = hello;
  probe.set_client(name_ + " (probe)");
  const auto health = std::make_shared<ServerHealth>(ServerHealth::Options{probe, frame_bytes, options_.env_timeout});
  evaluations_ = std::make_unique<EvaluationWorker>(
      EvaluationWorker::Options{name_, options_.env_servers, health, hello, spec, config.tile()}, &learner_);

  MutexLock lock(&mu_);
  for (int i = 0; i < options_.threads; ++i) {
    ActorLoop::Options loop = {i, config, frame_bytes, spec.state_size};
    loops_.push_back(std::make_unique<ActorLoop>(loop, &learner_, &permits_, policies_.get(), &sender_,
                                                 std::make_unique<EnvPool>(options_.env_servers, hello, frame_bytes,
                                                                           std::hash<std::string>()(name_) + i, health),
                                                 &servers_));
  }
  for (const auto& loop : loops_) threads_.emplace_back([this, loop = loop.get()] { RunLoop(loop); });
  sender_.Start();
  return absl::OkStatus();
}

void Actor::RunLoop(ActorLoop* loop) {
  const absl::Status status = loop->Run();
  if (status.ok()) return;
  MutexLock lock(&mu_);
  if (loop_error_.ok()) loop_error_ = status;
  stopping_ = true;
  changed_.NotifyAll();
}

absl::Status Actor::KeepPermits() {
  Backoff backoff(kFirstRetry, kLastRetry);
  while (!stopping()) {
    std::vector<FailedPermit> failures;
    const v1::PermitRequest request = NextRequest(&failures);
    const absl::StatusOr<v1::PermitReply> reply = learner_.GetPermits(request);
    if (reply.ok()) {
      backoff.Reset();
      permits_.Told(failures);
      if (reply->finished()) return absl::OkStatus();
      const v1::RunConfig& config = joined_.config();
      if (const absl::Status status = CheckPermitReply(request, config.lanes(), config.env().frame_size(), *reply);
          !status.ok()) {
        return absl::DataLossError(absl::StrFormat("%s: its permits: %s", learner_.name(), status.message()));
      }
      TakeIn(*reply);
      continue;
    }
    switch (ReactionTo(Called::kPermits, reply.status())) {
      case Reaction::kJoinAgain:
        LogInfo("%s", reply.status().message());
        permits_.DropWaiting();
        sender_.DropWaiting();
        CRAFTFLEET_RETURN_IF_ERROR(Join());
        break;
      case Reaction::kRetry:
        Complain(reply.status());
        Pause(backoff.Next());
        break;
      default:
        return reply.status();
    }
  }
  return absl::CancelledError("stopping");
}

v1::PermitRequest Actor::NextRequest(std::vector<FailedPermit>* failures) {
  v1::PermitRequest request;
  request.set_actor(name_);
  request.set_epoch(joined_.epoch());
  request.set_capacity(options_.capacity);
  request.set_wait_ms(kPollMs);
  request.set_evaluates(evaluations_->ready());
  const bool uses_registry = options_.env_servers->uses_registry();
  if (uses_registry) {
    request.set_wants_env_servers(true);
    request.set_env_servers_generation(env_servers_generation_);
  }
  request.set_evaluation(evaluations_->current(joined_.epoch()));
  *request.mutable_summary() = Summary();
  // Those that registered speak for themselves, but would not say that they don't answer.
  for (v1::Peer& server : uses_registry ? servers_.NextNotAnswering(kServersTold) : servers_.Next(kServersTold)) {
    request.add_env_servers()->Swap(&server);
  }
  // Before the permits that are at hand: one that fails meanwhile is still among these and told of the next time.
  *failures = permits_.Failures(joined_.epoch());
  for (const FailedPermit& failed : *failures) {
    v1::LaneFailure* message = request.add_failures();
    message->set_lane(failed.permit.lane);
    message->set_fragment(failed.permit.fragment);
    message->set_reason(failed.reason);
  }
  for (const PermitProgress& progress : permits_.Progress()) {
    const HeldPermit& permit = progress.permit;
    if (permit.epoch != joined_.epoch()) continue;
    v1::Permit* message = request.add_active();
    message->set_lane(permit.lane);
    message->set_fragment(permit.fragment);
    message->set_policy_version(permit.policy_version);
    request.add_active_steps(progress.steps);
  }
  return request;
}

void Actor::TakeIn(const v1::PermitReply& reply) {
  if (reply.env_servers_generation() != env_servers_generation_) {
    env_servers_generation_ = reply.env_servers_generation();
    options_.env_servers->SetRegistered({reply.env_servers().begin(), reply.env_servers().end()});
  }
  if (reply.lost_size() > 0) LogWarning("%d permits lapsed: others play these fragments", reply.lost_size());
  for (const v1::Permit& lost : reply.lost()) {
    permits_.Release({joined_.epoch(), lost.lane(), lost.fragment(), lost.policy_version()});
  }
  for (const v1::Permit& permit : reply.granted()) {
    permits_.Add({joined_.epoch(), permit.lane(), permit.fragment(), permit.policy_version()});
  }
  if (reply.has_evaluation()) evaluations_->Give(joined_.epoch(), reply.evaluation());
}

void Actor::Complain(const absl::Status& error) {
  if (SteadyNow() - complained_ < kSayAgain) return;
  complained_ = SteadyNow();
  LogWarning("%s; trying again until it answers", error.message());
}

void Actor::StopLoops() {
  permits_.Close();
  learner_.Cancel();
  {
    MutexLock lock(&mu_);
    for (const auto& loop : loops_) loop->Cancel();
  }
  sender_.Stop();
  if (evaluations_ != nullptr) evaluations_->Stop();
  for (std::thread& thread : threads_) {
    if (thread.joinable()) thread.join();
  }
}

bool Actor::stopping() const {
  MutexLock lock(&mu_);
  return stopping_;
}

void Actor::Pause(absl::Duration pause) {
  MutexLock lock(&mu_);
  changed_.WaitFor(&mu_, pause, [this]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) { return stopping_; });
}

v1::ProcessSummary Actor::Summary() const {
  v1::ProcessSummary summary;
  summary.set_lanes(static_cast<int>(permits_.Active().size()));
  summary.set_policy_version(-1);
  Work total;
  Work recent;
  const MutexLock lock(&mu_);
  for (const auto& loop : loops_) {
    total.Add(loop->meter().Total());
    recent.Add(loop->meter().Recent());
    summary.set_policy_version(std::max(summary.policy_version(), loop->policy_version()));
  }
  wire::FillWork(total, recent, static_cast<int>(loops_.size()), &summary);
  wire::FillUsage(&summary);
  return summary;
}

void Actor::FillStatus(v1::StatusReply* reply) const {
  *reply->mutable_summary() = Summary();
  int64_t steps = 0;
  int64_t abandoned = 0;
  {
    const MutexLock lock(&mu_);
    reply->set_run_id(run_id_);
    for (const auto& loop : loops_) {
      steps += loop->meter().Total().done;
      abandoned += loop->abandoned();
    }
  }
  reply->set_name(name_);
  wire::AddMetric("env_steps", static_cast<double>(steps), reply);
  wire::AddMetric("fragments_accepted", static_cast<double>(sender_.accepted()), reply);
  wire::AddMetric("fragments_refused", static_cast<double>(sender_.refused()), reply);
  wire::AddMetric("fragments_resent", static_cast<double>(sender_.resent()), reply);
  wire::AddMetric("fragments_abandoned", static_cast<double>(abandoned), reply);
  v1::Peer* learner = reply->add_peers();
  learner->set_name(learner_.name());
  learner->set_role("learner");
  learner->set_address(options_.learner.address);
  for (v1::Peer& server : servers_.All()) reply->add_peers()->Swap(&server);
}

}  // namespace craftfleet
