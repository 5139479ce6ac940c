// An actor: joins a learner, plays what it is permitted to, until the run is over.

#ifndef CRAFTFLEET_ACTOR_ACTOR_H_
#define CRAFTFLEET_ACTOR_ACTOR_H_

#include <functional>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include <absl/status/status.h>
#include <absl/status/statusor.h>

#include "actor/actor_loop.h"
#include "actor/env_client.h"
#include "actor/env_directory.h"
#include "actor/error_policy.h"
#include "actor/evaluation_worker.h"
#include "actor/fragment_sender.h"
#include "actor/learner_client.h"
#include "actor/permit_book.h"
#include "actor/policy_source.h"
#include "actor/server_book.h"
#include "actor/server_health.h"
#include "common/mutex.h"
#include "common/wire/channel.h"
#include "craftfleet/v1/status.pb.h"

namespace craftfleet {

// Run is called once; Stop and FillStatus from any thread. The way of a fragment: Run (asks for permits) => ActorLoop
// (one thread each) => FragmentSender (one thread). Evaluations are played beside (EvaluationWorker, one thread).
class Actor {
 public:
  struct Options {
    wire::Endpoint learner;
    std::shared_ptr<EnvDirectory> env_servers;
    int threads = 1;                                  // loops, 1..256
    int capacity = 4096;                              // lanes to play at once, 1..4096
    absl::Duration env_timeout = kDefaultEnvTimeout;  // of each request to an environment server, 0.1..3600 s
    // Called once, with the run's configuration, before the actor joins and computes anything; may execute the process
    // again. Null: the process is as the run wants it.
    std::function<absl::Status(const v1::RunConfig&)> set_up = nullptr;
    absl::Status Validate() const;  // InvalidArgument names the flag and its range
  };

  static absl::StatusOr<std::unique_ptr<Actor>> Create(const Options& options);
  ~Actor();

  // Plays until the run is over or Stop is called (both ok). Waits, and says so, while the learner or the environment
  // servers can't be reached.
  //   FailedPrecondition: the handshake does not match.   Others: trouble that waiting can't mend.
  // `address` is where its status service listens, for the learner's status page.
  absl::Status Run(absl::string_view address);
  // Gives back what it holds; Run returns within seconds. Idempotent.
  void Stop() ABSL_LOCKS_EXCLUDED(mu_);

  void FillStatus(v1::StatusReply* reply) const ABSL_LOCKS_EXCLUDED(mu_);

 private:
  explicit Actor(const Options& options);

  // Joins the learner, and tries until it answers.   Cancelled: Stop was called.
  absl::Status Join();
  // Begins to play by the configuration that the learner gave.
  absl::Status StartLoops() ABSL_LOCKS_EXCLUDED(mu_);
  // Asks for permits and hands them out until the run is over.
  absl::Status KeepPermits();
  // What KeepPermits asks for; `failures` is what it tells.
  v1::PermitRequest NextRequest(std::vector<FailedPermit>* failures);
  void TakeIn(const v1::PermitReply& reply);
  // Says now and then what is wrong with the learner.
  void Complain(const absl::Status& error);
  void StopLoops() ABSL_LOCKS_EXCLUDED(mu_);
  void RunLoop(ActorLoop* loop) ABSL_LOCKS_EXCLUDED(mu_);
  // What the learner is told for its page about the fleet.
  v1::ProcessSummary Summary() const ABSL_LOCKS_EXCLUDED(mu_);
  bool stopping() const ABSL_LOCKS_EXCLUDED(mu_);
  void Pause(absl::Duration pause) ABSL_LOCKS_EXCLUDED(mu_);

  const Options options_;
  const std::string name_;  // unique: host-process-random
  LearnerClient learner_;
  ServerBook servers_;
  PermitBook permits_;
  FragmentSender sender_;
  std::string address_;       // of Run's thread, like the next
  v1::JoinReply joined_;      // the last one
  bool set_up_ = false;       // options_.set_up was called
  bool was_welcome_ = false;  // a learner has taken us once
  absl::Time complained_ = absl::InfinitePast();
  int64_t env_servers_generation_ = 0;  // of the learner's registry, as last heard
  std::unique_ptr<PolicySource> policies_;
  std::unique_ptr<EvaluationWorker> evaluations_;
  std::vector<std::thread> threads_;

  mutable Mutex mu_;
  CondVar changed_;
  bool stopping_ ABSL_GUARDED_BY(mu_) = false;
  absl::Status loop_error_ ABSL_GUARDED_BY(mu_);
  std::string run_id_ ABSL_GUARDED_BY(mu_);
  std::vector<std::unique_ptr<ActorLoop>> loops_ ABSL_GUARDED_BY(mu_);  // filled once
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_ACTOR_ACTOR_H_
