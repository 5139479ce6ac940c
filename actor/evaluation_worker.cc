#include "actor/evaluation_worker.h"

#include <algorithm>
#include <utility>
#include <vector>

#include "actor/error_policy.h"
#include "actor/evaluator.h"
#include "common/agent/policy.h"
#include "common/agent/weights.h"
#include "common/base/clock.h"
#include "common/base/status_macros.h"
#include "common/telemetry/log.h"
#include "common/wire/convert.h"

namespace craftfleet {
namespace {

constexpr absl::Duration kConnectTimeout = absl::Seconds(5);
constexpr absl::Duration kFirstResend = absl::Milliseconds(250);  // pause before a result is sent again
constexpr absl::Duration kLastResend = absl::Seconds(2);

}  // namespace

EvaluationWorker::EvaluationWorker(const Options& options, const LearnerClient* learner)
    : options_(options), learner_(learner), thread_([this] { Run(); }) {}

EvaluationWorker::~EvaluationWorker() { Stop(); }

bool EvaluationWorker::ready() const {
  const MutexLock lock(&mu_);
  return !dropped_ && SteadyNow() >= next_try_;
}

void EvaluationWorker::Assign(int64_t epoch, const v1::EvaluationTask& task) {
  const MutexLock lock(&mu_);
  if (job_.has_value()) return;
  job_ = Job{epoch, task};
  changed_.NotifyAll();
}

int64_t EvaluationWorker::current(int64_t epoch) const {
  const MutexLock lock(&mu_);
  return job_.has_value() && job_->epoch == epoch ? job_->task.id() : 0;
}

void EvaluationWorker::KeepOnly(int64_t epoch) {
  const MutexLock lock(&mu_);
  if (!job_.has_value() || job_->epoch == epoch) return;
  dropped_ = true;
  if (env_ != nullptr) env_->Cancel();
  changed_.NotifyAll();
}

void EvaluationWorker::Stop() {
  {
    const MutexLock lock(&mu_);
    stopping_ = true;
    if (env_ != nullptr) env_->Cancel();
    changed_.NotifyAll();
  }
  if (thread_.joinable()) thread_.join();
}

void EvaluationWorker::Run() {
  while (true) {
    Job job;
    {
      const MutexLock lock(&mu_);
      changed_.Wait(&mu_, [this]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) { return stopping_ || job_.has_value(); });
      if (stopping_) return;
      job = *job_;
    }
    const absl::Status status = Play(job);
    const MutexLock lock(&mu_);
    env_ = nullptr;
    job_.reset();
    const bool was_dropped = std::exchange(dropped_, false);
    if (status.ok()) {
      backoff_.Reset();
    } else if (!stopping_ && !was_dropped && !absl::IsCancelled(status)) {  // Cancelled: the actor is stopping
      next_try_ = SteadyNow() + backoff_.Next();
      LogWarning("evaluation task %d returned: %s", job.task.id(), status.message());
    }
  }
}

absl::Status EvaluationWorker::Play(const Job& job) {
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::shared_ptr<const PolicyWeights> weights, GetWeights(job.task.id()));
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::unique_ptr<const Policy> policy,
                              Policy::Create(options_.spec, weights, options_.tile, options_.device));
  CRAFTFLEET_ASSIGN_OR_RETURN(EnvClient * env, Connect(job.task.env()));
  EvaluationOptions evaluation;
  evaluation.seed = job.task.seed();
  evaluation.first_episode = job.task.first_episode();
  evaluation.episodes = job.task.episodes();
  evaluation.greedy = job.task.greedy();
  const absl::StatusOr<std::vector<Episode>> episodes = Evaluate(evaluation, *policy, env, [](int) {});
  if (!episodes.ok()) {
    Blame(*env, episodes.status());
    return episodes.status();
  }
  v1::EvaluationResult result = wire::ToProto(*episodes);
  result.set_actor(options_.actor);
  result.set_epoch(job.epoch);
  result.set_id(job.task.id());
  return Send(result);
}

absl::Status EvaluationWorker::Send(const v1::EvaluationResult& result) {
  Backoff backoff(kFirstResend, kLastResend);
  while (true) {
    absl::Status status = learner_->FinishEvaluation(result);
    if (status.ok() || absl::IsCancelled(status) || !IsTransient(CallKind::kPlay, status)) return status;
    // A learner that no longer knows this actor takes the result once the actor has joined again.
    const MutexLock lock(&mu_);
    const bool is_over = changed_.WaitFor(
        &mu_, backoff.Next(), [this]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) { return stopping_ || dropped_; });
    if (is_over) return absl::CancelledError("stopping");
  }
}

absl::StatusOr<std::shared_ptr<const PolicyWeights>> EvaluationWorker::GetWeights(int64_t id) const {
  if (options_.weights.has_value()) {
    std::shared_ptr<const PolicyWeights> weights = options_.weights->find_of_evaluation(id);
    if (weights == nullptr) return absl::AbortedError("it is over");
    return weights;
  }
  CRAFTFLEET_ASSIGN_OR_RETURN(std::string weights, learner_->GetEvaluationWeights(id, MaxWeightsBytes(options_.spec)));
  return std::make_shared<const HostWeights>(std::move(weights));
}

absl::StatusOr<EnvClient*> EvaluationWorker::Connect(const v1::EnvConfig& env) {
  v1::SessionHello hello = options_.hello;
  *hello.mutable_env() = env;
  absl::Status status = absl::UnavailableError("no environment server is known yet");
  std::vector<wire::Endpoint> servers = options_.env_servers->Servers();
  if (servers.empty()) return status;
  std::rotate(servers.begin(), servers.begin() + static_cast<std::ptrdiff_t>(++tries_ % servers.size()), servers.end());
  // Slow servers come last: without another one they also play evaluations.
  const auto others = std::stable_partition(
      servers.begin(), servers.end(), [this](const wire::Endpoint& server) { return options_.health->MayUse(server); });
  for (auto server = servers.begin(); server != servers.end(); ++server) {
    if (server >= others && !options_.health->Of(server->address).is_slow) {
      status = absl::UnavailableError("environment server " + server->address + ": has not answered a probe");
      continue;
    }
    EnvClient* client = nullptr;
    {
      const MutexLock lock(&mu_);
      if (stopping_ || dropped_) return absl::CancelledError("stopping");
      env_ = std::make_unique<EnvClient>(*server, hello, static_cast<int>(options_.spec.frame_bytes()),
                                         options_.health->timeout());
      client = env_.get();
    }
    status = client->Connect(kConnectTimeout);
    if (status.ok()) return client;
    Blame(*client, status);
  }
  return status;
}

void EvaluationWorker::Blame(const EnvClient& env, const absl::Status& error) {
  if (env.connected()) return;  // an error of the policy: those of the session end it
  if (ReactionTo(CallKind::kSession, error) == Reaction::kProbeFirst) options_.health->Suspect(env.server(), error);
}

}  // namespace craftfleet
