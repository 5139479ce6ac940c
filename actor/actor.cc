#include "actor/actor.h"

#include <algorithm>
#include <functional>
#include <utility>

#include <absl/strings/str_format.h>

#include "actor/error_policy.h"
#include "actor/learner_replies.h"
#include "common/agent/agent_spec.h"
#include "common/agent/canary.h"
#include "common/agent/device.h"
#include "common/agent/torch_setup.h"
#include "common/base/backoff.h"
#include "common/base/clock.h"
#include "common/base/status_macros.h"
#include "common/config/known_canary.h"
#include "common/process/version.h"
#include "common/process/worker_name.h"
#include "common/telemetry/log.h"
#include "common/wire/protocol.h"
#include "common/wire/status_service.h"

namespace craftfleet {
namespace {

constexpr absl::Duration kFirstRetry = absl::Milliseconds(250);
constexpr absl::Duration kLastRetry = absl::Seconds(2);
constexpr absl::Duration kLogAgain = absl::Seconds(10);  // between two lines about the same error
constexpr int kPollMs = 500;                             // long poll for permits; a tenth of the lease
constexpr int kGroups = 2;                               // of lanes that play in turn on a GPU
constexpr size_t kServersReported = 8;                   // environment servers reported to the learner per poll,
constexpr size_t kUnusableReported = 64;                 // or, of those from the learner, all unusable ones of a list

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
      stream_(&learner_, name_, &permits_) {}

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
  asked_to_stop_ = true;  // it has left
  if (!loop_error_.ok()) return loop_error_;
  return status.code() == absl::StatusCode::kCancelled ? absl::OkStatus() : status;
}

void Actor::Stop() {
  bool joined = false;
  {
    MutexLock lock(&mu_);
    if (std::exchange(asked_to_stop_, true)) return;
    stopping_ = true;
    changed_.NotifyAll();
    joined = !run_id_.empty();
  }
  // First of all, so that other actors can continue its lanes at once.
  if (joined) learner_.Leave(name_);
  learner_.Cancel();
  stream_.Cancel();
}

absl::Status Actor::Join() {
  v1::JoinRequest request;
  request.set_protocol_version(wire::kProtocolVersion);
  request.set_run_id(joined_.run_id());
  request.set_actor(name_);
  request.set_cpu(CpuDescription());
  request.set_address(wire::GrpcAddress(address_));  // printable, whatever the path of a Unix socket
  request.set_build(BuildId());
  request.set_only_ask(!run_.has_value());
  if (run_.has_value()) {
    CRAFTFLEET_ASSIGN_OR_RETURN(*request.mutable_canary(), PolicyCanary(*run_));
  }
  Backoff backoff(kFirstRetry, kLastRetry);
  while (!stopping()) {
    absl::StatusOr<v1::JoinReply> reply = learner_.Join(request);
    if (reply.ok()) {
      if (const absl::Status status = CheckJoinReply(&*reply); !status.ok()) {
        return absl::DataLossError(absl::StrFormat("%s: invalid reply to Join: %s", learner_.name(), status.message()));
      }
      if (request.only_ask()) {
        if (options_.set_up != nullptr) CRAFTFLEET_RETURN_IF_ERROR(options_.set_up(reply->config()));
        run_ = reply->config();
        return Join();
      }
      was_accepted_ = true;
      joined_ = *std::move(reply);
      const auto& formats = joined_.frame_formats();
      const bool takes = std::find(formats.begin(), formats.end(), static_cast<int>(options_.frames)) != formats.end();
      fragment_format_ = takes ? options_.frames : FrameFormat::kRaw;
      MutexLock lock(&mu_);
      run_id_ = joined_.run_id();
      LogInfo("%s: joined run %s, epoch %d", learner_.name(), joined_.run_id(), joined_.epoch());
      return absl::OkStatus();
    }
    // A learner that accepted this actor before may be changing rights, so a refusal is treated as for other calls.
    const CallKind call = was_accepted_ && IsAboutRights(reply.status()) ? CallKind::kPlay : CallKind::kJoin;
    if (!IsTransient(call, reply.status())) return reply.status();
    LogRetry(reply.status());
    Pause(backoff.Next());
  }
  return absl::CancelledError("stopping");
}

absl::Status Actor::StartLoops() {
  const v1::RunConfig& config = joined_.config();
  CRAFTFLEET_ASSIGN_OR_RETURN(const AgentSpec spec, MakeAgentSpec(config));
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string device, options_.find_device != nullptr
                                                            ? options_.find_device(config.device())
                                                            : FindActingDevice("auto", config.device()));
  const bool on_gpu = device != "cpu";
  // A GPU computes all lanes of a group at once. While it does, the other group's games go on.
  const int tile = on_gpu ? std::min((config.lanes() + kGroups - 1) / kGroups, Policy::kMaxTile) : config.tile();
  const int loops = on_gpu ? std::min(kGroups, options_.threads) : options_.threads;
  if (on_gpu) {
    SetUpDevice(device, spec.precision);
    LogInfo("acting on %s, %d lanes at once", device, tile);
  }
  permits_.Distribute(tile, loops);
  policies_ = std::make_unique<PolicySource>(&learner_, spec, tile, device, options_.weights);

  v1::SessionHello hello;
  hello.set_protocol_version(wire::kProtocolVersion);
  hello.set_run_id(joined_.run_id());
  hello.set_texture_digest(joined_.texture_digest());
  *hello.mutable_env() = config.env();
  hello.set_client(name_);
  hello.set_game_canary(joined_.game_canary());
  if (options_.frames == FrameFormat::kScene && joined_.texture_digest() != kBuiltInTextures) {
    LogInfo("frames travel raw, since the run has other textures than this program");
  } else if (options_.frames != FrameFormat::kRaw) {
    hello.add_frame_formats(static_cast<v1::FrameFormat>(options_.frames));
  }
  const int frame_bytes = static_cast<int>(spec.frame_bytes());
  v1::SessionHello probe = hello;
  probe.set_client(name_ + " (probe)");
  const auto health = std::make_shared<ServerHealth>(ServerHealth::Options{probe, frame_bytes, options_.env_timeout});
  evaluations_ =
      std::make_unique<EvaluationWorker>(EvaluationWorker::Options{name_, options_.env_servers, health, hello, spec,
                                                                   config.tile(), device, options_.weights},
                                         &learner_);

  MutexLock lock(&mu_);
  for (int i = 0; i < loops; ++i) {
    ActorLoop::Options loop = {
        i, config, frame_bytes, spec.state_size, KeepsEveryState(spec, config.ppo()), &fragment_format_};
    loops_.push_back(std::make_unique<ActorLoop>(loop, &learner_, &permits_, policies_.get(), &stream_,
                                                 std::make_unique<EnvPool>(options_.env_servers, hello, frame_bytes,
                                                                           std::hash<std::string>()(name_) + i, health),
                                                 &servers_));
  }
  for (const auto& loop : loops_) threads_.emplace_back([this, loop = loop.get()] { RunLoop(loop); });
  stream_.Start();
  return absl::OkStatus();
}

void Actor::RunLoop(ActorLoop* loop) {
  const absl::Status status = loop->Run();
  if (status.ok()) return;
  {
    const MutexLock lock(&mu_);
    if (loop_error_.ok()) loop_error_ = status;
    stopping_ = true;
    changed_.NotifyAll();
  }
  stream_.Cancel();  // a request that waits
}

absl::Status Actor::KeepPermits() {
  Backoff backoff(kFirstRetry, kLastRetry);
  bool joined_again = false;  // since the last reply
  bool answered = false;      // since the last error; one reply says little about a stream that breaks again and again
  while (!stopping()) {
    std::vector<HeldPermit> failures;
    const v1::PermitRequest request = NextRequest(&failures);
    const absl::StatusOr<v1::PermitReply> reply = stream_.Ask(request);
    if (reply.ok()) {
      if (std::exchange(answered, true)) backoff.Reset();
      joined_again = false;
      permits_.SetReported(failures);
      if (reply->finished()) return absl::OkStatus();
      const v1::RunConfig& config = joined_.config();
      if (const absl::Status status = CheckPermitReply(request, config.lanes(), config.env().frame_size(), *reply);
          !status.ok()) {
        return absl::DataLossError(absl::StrFormat("%s: invalid permits: %s", learner_.name(), status.message()));
      }
      HandleReply(*reply);
      continue;
    }
    answered = false;
    switch (ReactionTo(CallKind::kPlay, reply.status())) {
      case Reaction::kJoinAgain:
        if (std::exchange(joined_again, true)) Pause(backoff.Next());
        LogInfo("%s", reply.status().message());
        permits_.DropWaiting();
        stream_.DropWaiting();
        CRAFTFLEET_RETURN_IF_ERROR(Join());
        evaluations_->KeepOnly(joined_.epoch());
        break;
      case Reaction::kRetry:
        LogRetry(reply.status());
        Pause(backoff.Next());
        break;
      default:
        return reply.status();
    }
  }
  return absl::CancelledError("stopping");
}

v1::PermitRequest Actor::NextRequest(std::vector<HeldPermit>* failures) {
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
  // Registered servers report themselves, but they can't report that this actor can't use them.
  for (v1::Peer& server : uses_registry ? servers_.NextUnusable(kUnusableReported) : servers_.Next(kServersReported)) {
    request.add_env_servers()->Swap(&server);
  }
  // Read before the active permits: a permit that fails in between is still active, and is reported next time.
  *failures = permits_.Failures(joined_.epoch());
  for (const HeldPermit& failed : *failures) {
    v1::LaneFailure* message = request.add_failures();
    message->set_lane(failed.lane);
    message->set_fragment(failed.fragment);
    message->set_reason(failed.failure);
  }
  for (const HeldPermit& permit : permits_.Active()) {
    if (permit.epoch != joined_.epoch()) continue;
    v1::Permit* message = request.add_active();
    message->set_lane(permit.lane);
    message->set_fragment(permit.fragment);
    message->set_policy_version(permit.policy_version);
  }
  return request;
}

void Actor::HandleReply(const v1::PermitReply& reply) {
  if (reply.env_servers_generation() != env_servers_generation_) {
    env_servers_generation_ = reply.env_servers_generation();
    options_.env_servers->SetRegistered({reply.env_servers().begin(), reply.env_servers().end()});
  }
  if (reply.lost_size() > 0) {
    log_.Warn("lapsed", absl::StrFormat("%d permits lapsed: others play these fragments", reply.lost_size()));
  }
  for (const v1::Permit& lost : reply.lost()) {
    permits_.Release({{lost.lane(), lost.fragment(), lost.policy_version()}, joined_.epoch()});
  }
  for (const v1::Permit& permit : reply.granted()) {
    HeldPermit held{{permit.lane(), permit.fragment(), permit.policy_version()}, joined_.epoch()};
    held.reload = permit.reload();
    permits_.Add(held);
  }
  if (reply.has_evaluation()) evaluations_->Assign(joined_.epoch(), reply.evaluation());
}

void Actor::LogRetry(const absl::Status& error) {
  if (stopping() || SteadyNow() - retry_logged_ < kLogAgain) return;
  retry_logged_ = SteadyNow();
  LogWarning("%s; trying again until it answers", error.message());
}

void Actor::StopLoops() {
  permits_.Close();
  learner_.Cancel();
  {
    MutexLock lock(&mu_);
    for (const auto& loop : loops_) loop->Cancel();
  }
  stream_.Stop();
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
  wire::AddMetric("fragments_accepted", static_cast<double>(stream_.accepted()), reply);
  wire::AddMetric("fragments_refused", static_cast<double>(stream_.refused()), reply);
  wire::AddMetric("fragments_resent", static_cast<double>(stream_.resent()), reply);
  wire::AddMetric("fragments_abandoned", static_cast<double>(abandoned), reply);
  v1::Peer* learner = reply->add_peers();
  learner->set_name(learner_.name());
  learner->set_role("learner");
  learner->set_address(options_.learner.address);
  for (v1::Peer& server : servers_.All()) reply->add_peers()->Swap(&server);
}

}  // namespace craftfleet
