// The registry of the learner's workers and their work, with one lock and one clock.

#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <absl/base/thread_annotations.h>
#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>
#include <absl/time/time.h>
#include <absl/types/span.h>

#include "common/base/clock.h"
#include "common/base/mutex.h"
#include "common/base/types.h"
#include "learner/scheduling/build_check.h"
#include "learner/scheduling/evaluation_table.h"
#include "learner/scheduling/lane_scheduler.h"
#include "learner/scheduling/server_reports.h"
#include "learner/scheduling/worker.h"
#include "learner/scheduling/worker_table.h"

namespace craftfleet {

// Who is there, and the one lock of all that schedules: lanes(), evaluations() and builds() give these parts to their
// callers with the lock held. Each call is atomic. Thread-safe.
//
// A worker has a record (WorkerTable) from its first call until status pages forget it. An actor that has joined is
// there while its lease lasts; so is an environment server that has registered, and each actor gets the addresses of
// its list of servers (ServerLists).
class WorkerRegistry {
 public:
  using Health = WorkerHealth;

  struct Options {
    LaneScheduler::Options lanes;  // its lease also applies to evaluations
    absl::Duration server_lease = absl::Seconds(8);
    WorkerTable::Options names = {};
    BuildCheck::Options build = {};
  };
  struct WorkerId {
    WorkerRole role;
    std::string name;
  };
  struct LaneFailure {
    int lane = 0;
    int64_t fragment = 0;
    std::string reason;
  };
  struct PermitRequest {
    WorkerClient client;
    int64_t stream = 0;  // that it came on; later streams have larger numbers
    std::string actor;
    std::vector<Permit> active;  // held by the actor
    std::vector<LaneFailure> failures;
    int capacity = 0;                                   // lanes it can play at once
    absl::Duration wait;                                // longest time to wait for permits
    bool evaluates = false;                             // it can play evaluations
    int64_t evaluation = 0;                             // its current task; 0: none
    bool wants_servers = false;                         // it gets its environment servers from here
    int64_t servers_generation = 0;                     // of its current list; 0: none
    std::shared_ptr<const v1::ProcessSummary> summary;  // null: none
    std::vector<ServerReport> servers;
    std::function<bool()> is_cancelled;  // whether the client disconnected; may be null. Called with the lock held
  };
  struct PermitReply {
    std::vector<Permit> granted;
    std::vector<Permit> lost;  // those of `active` that lapsed, whether or not another actor has them now
    bool finished = false;     // the run is over
    std::optional<EvaluationTable::Task> evaluation;
    int64_t servers_generation = 0;
    std::vector<std::string> servers;  // addresses of its list, if the actor's generation is outdated
  };
  // A worker as status pages show it.
  struct WorkerInfo {
    Worker worker;
    Health health = Health::kOk;
    absl::Duration silent;                     // since it was last seen
    bool summary_is_old = false;               // its figures are outdated
    bool refused = false;                      // refused because of its canary
    std::optional<LaneTable::ActorInfo> play;  // of an active actor
    bool evaluates = false;                    // it plays an evaluation
    size_t listed = 0;                         // an actor's environment servers from here; 0: it uses others
    size_t servers = 0;                        // that there are for lists

    bool IsDrained() const {
      return worker.draining && (play.has_value() ? play->permits == 0 && !evaluates : worker.empty);
    }
  };

  // `lanes` has `options.lanes.lanes` records. `clock` outlives the registry.
  WorkerRegistry(const Options& options, std::vector<LaneRecord> lanes, Clock* clock);

  // A part of the registry with the lock held, to be used within one statement, such as
  // `registry.lanes()->table().Records()`. Afterwards, requests that may now get permits are tried again.
  template <typename Part>
  class Locked {
   public:
    Locked(const WorkerRegistry* registry, Part* part, WorkerRegistry* waker) ABSL_NO_THREAD_SAFETY_ANALYSIS
        : registry_(registry),
          part_(part),
          waker_(waker) {
      registry_->mu_.Lock();
    }
    ~Locked() ABSL_NO_THREAD_SAFETY_ANALYSIS {
      if (waker_ != nullptr) waker_->WakeIfChanged();
      registry_->mu_.Unlock();
    }
    Locked(const Locked&) = delete;
    Locked& operator=(const Locked&) = delete;
    Part* operator->() const { return part_; }

   private:
    const WorkerRegistry* const registry_;
    Part* const part_;
    WorkerRegistry* const waker_;
  };
  Locked<LaneScheduler> lanes() ABSL_NO_THREAD_SAFETY_ANALYSIS { return {this, &lanes_, this}; }
  Locked<const LaneScheduler> lanes() const ABSL_NO_THREAD_SAFETY_ANALYSIS { return {this, &lanes_, nullptr}; }
  Locked<EvaluationTable> evaluations() ABSL_NO_THREAD_SAFETY_ANALYSIS { return {this, &evaluations_, nullptr}; }
  Locked<const BuildCheck> builds() const ABSL_NO_THREAD_SAFETY_ANALYSIS { return {this, &builds_, nullptr}; }

  // -- Workers. Calls with a `client` return the errors of UseName.

  // Records that `client` calls as the worker `name`.
  //   PermissionDenied: another identity owns the name.   ResourceExhausted: the identity already has kMaxNames names,
  //   or `max_names_per_client` from this host.
  absl::Status UseName(WorkerRole role, absl::string_view name, const WorkerClient& client) ABSL_LOCKS_EXCLUDED(mu_);
  // Makes an actor active, or renews its lease.   FailedPrecondition: as BuildCheck::Check.
  absl::Status Join(const WorkerClient& client, absl::string_view actor, absl::string_view address,
                    const WorkerBuild& build) ABSL_LOCKS_EXCLUDED(mu_);
  // Renews the actor's lease and permits, the `first` time, and grants it more. nullopt: there is nothing to grant;
  // call it again once the registry has changed, and at the latest after `request.wait`, as the `last` time, which
  // always gives a reply.
  //   Aborted: the actor is unknown or has left, and must join (again).   Unavailable: Close was called.
  //   Cancelled: the client disconnected.
  std::optional<absl::StatusOr<PermitReply>> TryPermits(const PermitRequest& request, bool first, bool last)
      ABSL_LOCKS_EXCLUDED(mu_);
  // Called, with the lock held, after each change that may let TryPermits give a reply to `actor`; empty: to any.
  using Observer = std::function<void(absl::string_view actor)>;
  void SetObserver(Observer observer) ABSL_LOCKS_EXCLUDED(mu_);  // null: none
  // The connection of a `stream` of `actor` broke: shortens its lease to `comeback`, unless it has sent a request on a
  // later stream.
  void OnConnectionLost(absl::string_view actor, int64_t stream = 0) ABSL_LOCKS_EXCLUDED(mu_);
  // Makes an environment server active, or renews its lease. `lanes`: its open games.   FailedPrecondition: as Join.
  absl::Status Announce(const WorkerClient& client, absl::string_view name, absl::string_view address, int lanes,
                        const WorkerBuild& build, std::shared_ptr<const v1::ProcessSummary> summary = nullptr)
      ABSL_LOCKS_EXCLUDED(mu_);
  absl::Duration server_lease() const { return options_.server_lease; }
  // The worker leaves: frees its permits, tasks and name. Unknown workers are ignored.
  absl::Status Leave(const WorkerClient& client, WorkerRole role, absl::string_view name,
                     absl::string_view address = "") ABSL_LOCKS_EXCLUDED(mu_);

  // With `draining`, stops new work for the worker: an actor's lanes go to others as soon as it has played its permits,
  // and actors move their games away from a server. Else it gets work again. `worker`: name or address of an active
  // one.
  //   NotFound: no such worker; lists the active ones.
  absl::StatusOr<WorkerId> SetDraining(absl::string_view worker, bool draining) ABSL_LOCKS_EXCLUDED(mu_);
  // Whether the worker is gone, or is being drained and has no permits, evaluation or (by its last report) games left.
  bool IsDrained(const WorkerId& worker) ABSL_LOCKS_EXCLUDED(mu_);

  // Records for the status page: actors first, then environment servers, each ordered by name.
  std::vector<WorkerInfo> Workers() const ABSL_LOCKS_EXCLUDED(mu_);
  // What the run waits for: the fragments and evaluation tasks that are being played, the oldest first, and by whom.
  // For log lines.
  std::string WaitsFor() const ABSL_LOCKS_EXCLUDED(mu_);

  // -- Play.

  // LaneScheduler::Judge for a fragment that `client` sends as `actor`; kExpired unless that actor has joined.   Errors
  // also as UseName, but no name becomes the client's.
  absl::StatusOr<LaneScheduler::Verdict> Judge(const WorkerClient& client, absl::string_view actor,
                                               const Permit& fragment) ABSL_LOCKS_EXCLUDED(mu_);
  // LaneScheduler::Accept; also renews the actor's lease.
  absl::StatusOr<LaneScheduler::Verdict> Accept(absl::string_view actor, const Permit& fragment,
                                                const LaneSnapshot& snapshot, uint64_t digest = 0)
      ABSL_LOCKS_EXCLUDED(mu_);
  // The run is over: actors are told to leave.
  void Finish() ABSL_LOCKS_EXCLUDED(mu_);
  // The learner stops before the end of the run: nothing more is granted and every waiting call returns.
  void Close() ABSL_LOCKS_EXCLUDED(mu_);
  // Waits until every actor has left, at most `timeout`.
  void WaitUntilEmpty(absl::Duration timeout) ABSL_LOCKS_EXCLUDED(mu_);

  // The result of an actor.   Aborted: the actor is unknown or has left, and must join (again).
  absl::Status FinishEvaluation(absl::string_view actor, int64_t task, absl::Span<const Episode> episodes)
      ABSL_LOCKS_EXCLUDED(mu_);
  // Waits up to `timeout` until the oldest evaluation is finished. EvaluationTable::Pop removes it.
  std::optional<FinishedEvaluation> FrontEvaluation(absl::Duration timeout) ABSL_LOCKS_EXCLUDED(mu_);

 private:
  // The record of the worker that `client` calls as; frees what a former owner of the name had.   Errors as UseName.
  absl::StatusOr<Worker*> Own(WorkerRole role, absl::string_view name, const WorkerClient& client)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // As BuildCheck::Check.
  absl::Status CheckBuild(const WorkerBuild& build, Worker* worker) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // Makes `actor` inactive and frees its permits and evaluations.
  void RemoveActor(Worker* actor) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void ExpireActors() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // Nothing: status pages do not show the worker.
  std::optional<WorkerInfo> InfoOf(const Worker& worker) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);

  // The parts of TryPermits. Notes failures and renews the actor's lease, permits and evaluation.   Errors as
  // TryPermits.
  absl::Status ReportAndRenew(const PermitRequest& request, PermitReply* reply) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // Grants what there is. Returns whether the request need not wait longer.
  bool TryGrant(const PermitRequest& request, PermitReply* reply) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // Notes the rest of the request and fills in the rest of the reply.   Errors as TryPermits.
  absl::StatusOr<PermitReply> Complete(const PermitRequest& request, PermitReply reply)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // Wakes calls of `actor` that wait for permits; empty: all, and those that wait for the last actor to leave.
  void Wake(absl::string_view actor = "") ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // The same if there may be new permits.
  void WakeIfChanged() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);

  const Options options_;
  Clock* const clock_;
  const int64_t first_generation_;  // of servers' lists: the date in microseconds, so that it exceeds earlier starts'

  mutable Mutex mu_;
  CondVar left_;       // an actor
  CondVar evaluated_;  // an evaluation task is over
  Observer observer_ ABSL_GUARDED_BY(mu_);
  WorkerTable workers_ ABSL_GUARDED_BY(mu_);
  ServerReports reports_ ABSL_GUARDED_BY(mu_);
  LaneScheduler lanes_ ABSL_GUARDED_BY(mu_);
  EvaluationTable evaluations_ ABSL_GUARDED_BY(mu_);
  BuildCheck builds_ ABSL_GUARDED_BY(mu_);
  bool finished_ ABSL_GUARDED_BY(mu_) = false;
  bool closed_ ABSL_GUARDED_BY(mu_) = false;
};

}  // namespace craftfleet
