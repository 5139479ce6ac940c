// Plays the evaluation tasks that the learner assigns, on its own thread.

#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <thread>

#include <absl/status/status.h>
#include <absl/time/time.h>

#include "actor/env_client.h"
#include "actor/env_directory.h"
#include "actor/learner_client.h"
#include "actor/policy_source.h"
#include "actor/server_health.h"
#include "common/agent/agent_spec.h"
#include "common/base/backoff.h"
#include "common/base/mutex.h"
#include "craftfleet/v1/environment.pb.h"
#include "craftfleet/v1/learner.pb.h"

namespace craftfleet {

// Plays one task at a time. A task that can't be played is dropped; the learner assigns it again. A result, which may
// have taken hours, is sent until the learner has answered. Thread-safe.
class EvaluationWorker {
 public:
  struct Options {
    std::string actor;  // the actor's name
    std::shared_ptr<EnvDirectory> env_servers;
    std::shared_ptr<ServerHealth> health;  // of env_servers
    v1::SessionHello hello;                // of sessions; the task's environment replaces its own
    AgentSpec spec;
    int tile = 1;
    std::string device = "cpu";                // of the policy
    std::optional<LocalWeights> weights = {};  // none: call the learner for them
  };

  // Starts the thread. `learner` outlives this.
  EvaluationWorker(const Options& options, const LearnerClient* learner);
  ~EvaluationWorker();

  // Whether a task would be accepted if there is none; false for a while after a task that could not be played.
  bool ready() const ABSL_LOCKS_EXCLUDED(mu_);
  // Starts to play `task` of learner epoch `epoch`, unless there is already a task.
  void Assign(int64_t epoch, const v1::EvaluationTask& task) ABSL_LOCKS_EXCLUDED(mu_);
  // The id of the current task if it is of `epoch`; 0: none.
  int64_t current(int64_t epoch) const ABSL_LOCKS_EXCLUDED(mu_);
  // Drops the current task unless it is of `epoch`: no other start of the learner takes its result.
  void KeepOnly(int64_t epoch) ABSL_LOCKS_EXCLUDED(mu_);
  // Ends the current task and the thread. Idempotent.
  void Stop() ABSL_LOCKS_EXCLUDED(mu_);

 private:
  struct Job {
    int64_t epoch = 0;
    v1::EvaluationTask task;
  };

  void Run() ABSL_LOCKS_EXCLUDED(mu_);
  absl::Status Play(const Job& job) ABSL_LOCKS_EXCLUDED(mu_);
  // Of task `id`.   Aborted: it is over.   Others as LearnerClient::GetEvaluationWeights.
  absl::StatusOr<std::shared_ptr<const PolicyWeights>> GetWeights(int64_t id) const;
  // Begins a session with the first environment server that answers, starting from another one each time; a slow one
  // only if there is no other.
  //   Cancelled: Stop was called, or the task is dropped.   Unavailable: none answers.
  absl::StatusOr<EnvClient*> Connect(const v1::EnvConfig& env) ABSL_LOCKS_EXCLUDED(mu_);
  // Sends the result, with growing pauses while the learner can't take it.   Cancelled: as Connect.   Others: why it
  // refuses the result.
  absl::Status Send(const v1::EvaluationResult& result) ABSL_LOCKS_EXCLUDED(mu_);
  // Marks the server as suspect if it did not answer or sent an invalid answer.
  void Blame(const EnvClient& env, const absl::Status& error);

  const Options options_;
  const LearnerClient* const learner_;

  mutable Mutex mu_;
  CondVar changed_;
  std::optional<Job> job_ ABSL_GUARDED_BY(mu_);
  Backoff backoff_ ABSL_GUARDED_BY(mu_){absl::Seconds(1), absl::Seconds(10)};
  absl::Time next_try_ ABSL_GUARDED_BY(mu_) = absl::InfinitePast();  // SteadyNow
  size_t tries_ = 0;                                                 // used only by the thread
  std::unique_ptr<EnvClient> env_ ABSL_GUARDED_BY(mu_);              // made and used by the thread; others cancel it
  bool dropped_ ABSL_GUARDED_BY(mu_) = false;                        // the current task
  bool stopping_ ABSL_GUARDED_BY(mu_) = false;
  std::thread thread_;
};

}  // namespace craftfleet
