// Plays the evaluations that a learner hands out, on a thread of its own.

#ifndef CRAFTFLEET_ACTOR_EVALUATION_WORKER_H_
#define CRAFTFLEET_ACTOR_EVALUATION_WORKER_H_

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
#include "actor/server_health.h"
#include "common/agent/agent_spec.h"
#include "common/backoff.h"
#include "common/mutex.h"
#include "craftfleet/v1/environment.pb.h"
#include "craftfleet/v1/learner.pb.h"

namespace craftfleet {

// One task at a time. A task that can't be played is dropped: the learner gives it to someone again. Thread-safe.
class EvaluationWorker {
 public:
  struct Options {
    std::string actor;  // name, as it joined
    std::shared_ptr<EnvDirectory> env_servers;
    std::shared_ptr<ServerHealth> health;  // of these
    v1::SessionHello hello;                // of a session; its environment is replaced by the task's
    AgentSpec spec;
    int tile = 1;
  };

  // Starts the thread. `learner` outlives this.
  EvaluationWorker(const Options& options, const LearnerClient* learner);
  ~EvaluationWorker();

  // Whether it would play a task; not for a while after one that it could not play.
  bool ready() const ABSL_LOCKS_EXCLUDED(mu_);
  // Plays `task` of the learner's start `epoch`, if nothing is at hand.
  void Give(int64_t epoch, const v1::EvaluationTask& task) ABSL_LOCKS_EXCLUDED(mu_);
  // Id of the task at hand in `epoch`; 0: none.
  int64_t current(int64_t epoch) const ABSL_LOCKS_EXCLUDED(mu_);
  // Ends the task at hand and the thread. Idempotent.
  void Stop() ABSL_LOCKS_EXCLUDED(mu_);

 private:
  struct Job {
    int64_t epoch = 0;
    v1::EvaluationTask task;
  };

  void Run() ABSL_LOCKS_EXCLUDED(mu_);
  absl::Status Play(const Job& job) ABSL_LOCKS_EXCLUDED(mu_);
  // A session with the first environment server that answers, each time from another one on.
  //   Cancelled: Stop was called.   Unavailable: none answers.
  absl::StatusOr<EnvClient*> Connect(const v1::EnvConfig& env) ABSL_LOCKS_EXCLUDED(mu_);
  // Puts a server under suspicion that did not answer, or nonsense.
  void Blame(const EnvClient& env, const absl::Status& error);

  const Options options_;
  const LearnerClient* const learner_;

  mutable Mutex mu_;
  CondVar changed_;
  std::optional<Job> job_ ABSL_GUARDED_BY(mu_);
  Backoff backoff_ ABSL_GUARDED_BY(mu_){absl::Seconds(1), absl::Seconds(10)};
  absl::Time next_try_ ABSL_GUARDED_BY(mu_) = absl::InfinitePast();  // SteadyNow
  size_t tries_ = 0;                                                 // of the thread
  std::unique_ptr<EnvClient> env_ ABSL_GUARDED_BY(mu_);              // made and used by the thread; Stop cancels it
  bool stopping_ ABSL_GUARDED_BY(mu_) = false;
  std::thread thread_;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_ACTOR_EVALUATION_WORKER_H_
