// An actor: joins a learner and plays fragments until the run is over.

#pragma once

#include <atomic>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include <absl/status/status.h>
#include <absl/status/statusor.h>

#include "actor/actor_loop.h"
#include "actor/env_client.h"
#include "actor/env_directory.h"
#include "actor/env_server_tracker.h"
#include "actor/error_policy.h"
#include "actor/evaluation_worker.h"
#include "actor/learner_client.h"
#include "actor/learner_stream.h"
#include "actor/permit_tracker.h"
#include "actor/policy_source.h"
#include "actor/server_health.h"
#include "common/base/clock.h"
#include "common/base/mutex.h"
#include "common/telemetry/limited_log.h"
#include "common/wire/channel.h"
#include "craftfleet/v1/status.pb.h"

namespace craftfleet {

// Run is called once; Stop and FillStatus may be called from any thread. Run requests permits; each ActorLoop (one
// thread each) plays fragments, and the LearnerStream (two threads) sends them. An EvaluationWorker (one thread) plays
// evaluations.
class Actor {
 public:
  struct Options {
    wire::Endpoint learner;
    std::shared_ptr<EnvDirectory> env_servers;
    int threads = 1;                                  // loops, 1..256
    int capacity = 4096;                              // lanes to play at once, 1..4096
    FrameFormat frames = FrameFormat::kScene;         // in which frames travel where both ends can
    absl::Duration env_timeout = kDefaultEnvTimeout;  // of each request to an environment server, 0.1..3600 s
    std::optional<LocalWeights> weights = {};         // of a learner in the same process; none: call it for them
    // The device to act on, in LibTorch's notation, in a run that computes on this type of device. Null: as
    // --device=auto.
    std::function<absl::StatusOr<std::string>(v1::RunConfig::Device)> find_device = nullptr;
    // Called once with the run's configuration, before the actor joins and computes anything; may restart the process
    // by exec. Null: nothing to set up.
    std::function<absl::Status(const v1::RunConfig&)> set_up = nullptr;
    absl::Status Validate() const;  // InvalidArgument names the flag and its range
  };

  static absl::StatusOr<std::unique_ptr<Actor>> Create(const Options& options);
  ~Actor();

  // Plays until the run is over or Stop is called (both ok). While the learner or the environment servers can't be
  // reached, waits and logs that. `address`: HOST:PORT of its status service, for the learner's status page.
  //   FailedPrecondition: the handshake does not match.   Others: errors that waiting does not resolve.
  absl::Status Run(absl::string_view address);
  // Releases all permits; Run returns within seconds. Idempotent.
  void Stop() ABSL_LOCKS_EXCLUDED(mu_);

  void FillStatus(v1::StatusReply* reply) const ABSL_LOCKS_EXCLUDED(mu_);

 private:
  explicit Actor(const Options& options);

  // Joins the learner; retries until it answers.   Cancelled: Stop was called.
  absl::Status Join();
  // Starts to play with the configuration in `joined_`.
  //   FailedPrecondition: the run acts on another type of device.
  absl::Status StartLoops() ABSL_LOCKS_EXCLUDED(mu_);
  // Requests permits and distributes them until the run is over.
  absl::Status KeepPermits();
  // Makes the next request for permits. `failures`: set to the failures that it reports.
  v1::PermitRequest NextRequest(std::vector<HeldPermit>* failures);
  void HandleReply(const v1::PermitReply& reply);
  // Logs, at a limited rate, why calls to the learner fail.
  void LogRetry(const absl::Status& error);
  void StopLoops() ABSL_LOCKS_EXCLUDED(mu_);
  void RunLoop(ActorLoop* loop) ABSL_LOCKS_EXCLUDED(mu_);
  // The actor's summary for the learner's status page.
  v1::ProcessSummary Summary() const ABSL_LOCKS_EXCLUDED(mu_);
  bool stopping() const ABSL_LOCKS_EXCLUDED(mu_);
  void Pause(absl::Duration pause) ABSL_LOCKS_EXCLUDED(mu_);

  const Options options_;
  const std::string name_;  // unique: host-process-random
  LearnerClient learner_;
  EnvServerTracker servers_;
  PermitTracker permits_;
  LearnerStream stream_;
  std::string address_;               // this and the next are used only by Run's thread
  v1::JoinReply joined_;              // the last one
  std::optional<v1::RunConfig> run_;  // that it was set up for, before it joined
  bool was_accepted_ = false;         // a learner has accepted it before
  RealClock clock_;
  LimitedLog log_{&clock_};  // of what the learner causes
  absl::Time retry_logged_ = absl::InfinitePast();
  int64_t env_servers_generation_ = 0;                           // of the learner's registry, as last received
  std::atomic<FrameFormat> fragment_format_{FrameFormat::kRaw};  // options_.frames if the learner takes that
  std::unique_ptr<PolicySource> policies_;
  std::unique_ptr<EvaluationWorker> evaluations_;
  std::vector<std::thread> threads_;

  mutable Mutex mu_;
  CondVar changed_;
  bool stopping_ ABSL_GUARDED_BY(mu_) = false;
  bool asked_to_stop_ ABSL_GUARDED_BY(mu_) = false;  // by Stop, rather than by the error of a loop
  absl::Status loop_error_ ABSL_GUARDED_BY(mu_);
  std::string run_id_ ABSL_GUARDED_BY(mu_);
  std::vector<std::unique_ptr<ActorLoop>> loops_ ABSL_GUARDED_BY(mu_);  // filled once
};

}  // namespace craftfleet
