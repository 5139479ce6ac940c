// The registry of the learner's workers and their work, with one lock and one clock.

#ifndef CRAFTFLEET_LEARNER_SCHEDULING_WORKER_REGISTRY_H_
#define CRAFTFLEET_LEARNER_SCHEDULING_WORKER_REGISTRY_H_

#include <cstddef>
#include <cstdint>
#include <functional>
#include <limits>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>
#include <absl/time/time.h>
#include <absl/types/span.h>

#include "common/base/clock.h"
#include "common/base/mutex.h"
#include "common/base/types.h"
#include "learner/scheduling/build_check.h"
#include "learner/scheduling/evaluation_scheduler.h"
#include "learner/scheduling/lane_scheduler.h"
#include "learner/scheduling/server_lists.h"
#include "learner/scheduling/worker.h"

namespace craftfleet {

// Keeps one record of each actor and environment server, and calls the policies (LaneScheduler, EvaluationScheduler,
// BuildCheck) under its mutex. Each call is atomic, except that GetPermits releases the mutex while it waits.
//
// Names: the first identity (common/wire/access.h) to use a name, or a server's address, owns it until the worker
// leaves or the name has not been used for `name_lapse`. Without TLS all workers have the same identity, so this has no
// effect.
//
// Environment servers: one per address. A server that registers an address already in use replaces the earlier server,
// which must be gone. A server that has not reported for `server_lease` is no longer listed. Each actor gets the
// addresses of its list (ServerLists).
//
// Records outlive their workers for a while, so that the status page shows missing workers. Thread-safe.
class WorkerRegistry {
 public:
  static constexpr absl::Duration kRememberLost = absl::Minutes(10);  // of lost and refused workers
  static constexpr absl::Duration kRememberLeft = absl::Minutes(1);
  static constexpr size_t kMaxGone = 64;     // lost workers and those that left; the newest are kept
  static constexpr int kMaxReported = 1024;  // servers known from actors' reports; further reports are ignored
  static constexpr size_t kMaxRefused = 16;  // workers with another canary; the newest are kept
  static constexpr size_t kPruneParts = 64;
  static constexpr absl::Duration kPruneEvery = absl::Seconds(1);
  static constexpr int kPollsPerSecond = 2000;  // requests for permits that get nothing, of all actors
  static constexpr absl::Duration kShortestPoll = absl::Milliseconds(500);
  static constexpr absl::Duration kLongestPoll = absl::Seconds(5);
  static constexpr size_t kServersOfALease = 1000;
  static constexpr int kMaxLeases = 8;
  static constexpr size_t kMaxNames = 16384;  // owned by one identity at a time, from all hosts

  struct Options {
    LaneScheduler::Options lanes;                    // its lease also applies to evaluations
    absl::Duration server_lease = absl::Seconds(8);  // of up to kServersOfALease servers; see LeaseForServers
    absl::Duration name_lapse = absl::Seconds(20);   // at least twice the longest lease of an actor
    // Names owned by one identity from one host at a time: as many as connections, of which each worker has one.
    int max_names_per_client = 1024;
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
  // An actor's report on an environment server.
  struct ServerReport {
    std::string address;
    bool answers = false;                               // the actor reaches it
    bool hangs = false;                                 // it is connected but does not answer
    std::shared_ptr<const v1::ProcessSummary> summary;  // null: none
    bool slow = false;                                  // it answers, but slowly
    double step_ms = 0;                                 // then: typical time of a step there
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
    bool resting = false;      // the run is paused or the actor is being drained, so it gets no work
    std::optional<EvaluationScheduler::Task> evaluation;
    absl::Duration wait;  // that the actor's next request should have: PollInterval
    int64_t servers_generation = 0;
    std::vector<std::string> servers;  // addresses of its list, if the actor's generation is outdated
  };
  struct Server {
    std::string name;
    std::string address;
    absl::Duration idle;  // since its last report
    bool draining = false;
  };
  enum class Health { kOk, kLost, kLeft, kNotAnswering, kSlow };
  // A worker as sums over the fleet need it.
  struct Glance {
    WorkerRole role = WorkerRole::kActor;
    Health health = Health::kOk;
    bool drained = false;                                         // has no work left, or gets none
    std::shared_ptr<const v1::ProcessSummary> summary = nullptr;  // null: none, or its figures are outdated
    std::string name = "";                                        // of a slow server, with its step time
  };
  // A worker as status pages show it.
  struct WorkerInfo {
    Worker worker;
    Health health = Health::kOk;
    absl::Duration silent;                         // since it was last seen
    bool summary_is_old = false;                   // its figures are outdated
    bool refused = false;                          // refused because of its canary
    std::optional<LaneScheduler::ActorInfo> play;  // of an active actor
    size_t listed = 0;                             // an actor's environment servers from here; 0: it uses others
    size_t servers = 0;                            // that there are for lists
  };

  // `lanes` has `options.lanes.lanes` records. `clock` outlives the registry.
  WorkerRegistry(const Options& options, std::vector<LaneRecord> lanes, Clock* clock);

  // -- Workers. Calls with a `client` return the errors of UseName.

  // Records that `client` calls as the worker `name`.
  //   PermissionDenied: another identity owns the name.   ResourceExhausted: the identity already has kMaxNames names,
  //   or `max_names_per_client` from this host.
  absl::Status UseName(WorkerRole role, absl::string_view name, const WorkerClient& client) ABSL_LOCKS_EXCLUDED(mu_);
  // Makes an actor active, or renews its lease.   FailedPrecondition: as BuildCheck::Check.
  absl::Status Join(const WorkerClient& client, absl::string_view actor, absl::string_view address,
                    const WorkerBuild& build) ABSL_LOCKS_EXCLUDED(mu_);
  // Renews the actor's lease and permits, and grants it more. Waits up to `request.wait` while there is nothing to
  // grant.
  //   Aborted: the actor is unknown or has left, and must join (again).   Unavailable: Close was called.
  //   Cancelled: the client disconnected.
  absl::StatusOr<PermitReply> GetPermits(const PermitRequest& request) ABSL_LOCKS_EXCLUDED(mu_);
  // The same in two steps that do not wait. nullopt: there is nothing to grant; call RetryPermits once the registry has
  // changed, and at the latest after `request.wait`, as the `last` time, which always gives a reply.
  std::optional<absl::StatusOr<PermitReply>> StartPermits(const PermitRequest& request) ABSL_LOCKS_EXCLUDED(mu_);
  std::optional<absl::StatusOr<PermitReply>> RetryPermits(const PermitRequest& request, bool last)
      ABSL_LOCKS_EXCLUDED(mu_);
  // Called, with the lock held, after each change that may let RetryPermits give a reply to `actor`; empty: to any.
  using Observer = std::function<void(absl::string_view actor)>;
  void SetObserver(Observer observer) ABSL_LOCKS_EXCLUDED(mu_);  // null: none
  // The connection of a `stream` of `actor` broke: shortens its lease to `comeback`, unless it has sent a request on a
  // later stream.
  void OnConnectionLost(absl::string_view actor, int64_t stream = 0) ABSL_LOCKS_EXCLUDED(mu_);
  // Makes an environment server active, or renews its lease. `lanes`: its open games.   FailedPrecondition: as Join.
  absl::Status Announce(const WorkerClient& client, absl::string_view name, absl::string_view address, int lanes,
                        const WorkerBuild& build, std::shared_ptr<const v1::ProcessSummary> summary = nullptr)
      ABSL_LOCKS_EXCLUDED(mu_);
  // The lease of servers that report now: `server_lease`, and as much more for each further kServersOfALease, up to
  // kMaxLeases times as long. They report several times in a lease, so this bounds how often reports come.
  absl::Duration LeaseForServers() const ABSL_LOCKS_EXCLUDED(mu_);
  // The number of active actors.
  int actors() const ABSL_LOCKS_EXCLUDED(mu_);
  // The worker leaves: frees its permits, tasks and name. Unknown workers are ignored.
  absl::Status Leave(const WorkerClient& client, WorkerRole role, absl::string_view name,
                     absl::string_view address = "") ABSL_LOCKS_EXCLUDED(mu_);

  // Stops new work for the worker: an actor's lanes go to others as soon as it has played its permits, and actors move
  // their games away from a server. `worker`: name or address of an active worker.
  //   NotFound: no such worker; lists the active ones.
  absl::StatusOr<WorkerId> Drain(absl::string_view worker) ABSL_LOCKS_EXCLUDED(mu_);
  // Ends Drain.   Errors as Drain.
  absl::StatusOr<WorkerId> Undrain(absl::string_view worker) ABSL_LOCKS_EXCLUDED(mu_);
  // Whether the worker is gone, or is being drained and has no permits, evaluation or (by its last report) games left.
  bool IsDrained(const WorkerId& worker) ABSL_LOCKS_EXCLUDED(mu_);

  // Records for the status page, at most `most`, of which those of workers that are lost, do not answer or are being
  // drained come first: actors first, then environment servers, each ordered by name.
  // `all`: also a glance at each, for sums; null: not wanted. Both together, because in a large fleet it is reaching
  // each worker's record that takes time.
  std::vector<WorkerInfo> Workers(size_t most = std::numeric_limits<size_t>::max(),
                                  std::vector<Glance>* all = nullptr) const ABSL_LOCKS_EXCLUDED(mu_);
  std::vector<LaneScheduler::ActorInfo> Actors() const ABSL_LOCKS_EXCLUDED(mu_);
  // Active servers ordered by address, including those being drained.
  std::vector<Server> Servers() ABSL_LOCKS_EXCLUDED(mu_);
  // The canary that actors require of environment servers; empty: any.
  std::string GameCanary() const ABSL_LOCKS_EXCLUDED(mu_);
  // What the run waits for: the fragments and evaluation tasks that are being played, the oldest first, and by whom.
  // For log lines.
  std::string WaitsFor() const ABSL_LOCKS_EXCLUDED(mu_);
  // As BuildCheck::differing.
  int64_t mixed() const ABSL_LOCKS_EXCLUDED(mu_);
  bool allow_mixed() const { return options_.build.allow_mixed; }

  // -- Lanes: see the methods of LaneScheduler with the same names.

  // Judge for a fragment that `client` sends as `actor`; kExpired unless that actor has joined.   Errors also as
  // UseName, but no name becomes the client's.
  absl::StatusOr<LaneScheduler::Verdict> Judge(const WorkerClient& client, absl::string_view actor,
                                               const Permit& fragment) ABSL_LOCKS_EXCLUDED(mu_);
  absl::StatusOr<LaneScheduler::Verdict> Accept(absl::string_view actor, const Permit& fragment,
                                                const LaneSnapshot& snapshot, uint64_t digest = 0)
      ABSL_LOCKS_EXCLUDED(mu_);
  bool Restore(const Permit& fragment, const LaneSnapshot& snapshot, uint64_t digest = 0) ABSL_LOCKS_EXCLUDED(mu_);
  bool Counts(int lane, int64_t fragment, uint64_t digest) const ABSL_LOCKS_EXCLUDED(mu_);
  absl::StatusOr<LaneSnapshot> Snapshot(int lane, int64_t fragment) const ABSL_LOCKS_EXCLUDED(mu_);
  void OpenIteration(int64_t last_fragment, int64_t policy_version) ABSL_LOCKS_EXCLUDED(mu_);
  void PublishVersion(int64_t policy_version) ABSL_LOCKS_EXCLUDED(mu_);
  std::optional<std::vector<Arrival>> TakeRollout() ABSL_LOCKS_EXCLUDED(mu_);
  void RewindIterations(int iterations) ABSL_LOCKS_EXCLUDED(mu_);
  bool SetPaused(bool paused) ABSL_LOCKS_EXCLUDED(mu_);
  bool paused() const ABSL_LOCKS_EXCLUDED(mu_);
  std::vector<LaneRecord> Records() const ABSL_LOCKS_EXCLUDED(mu_);
  std::vector<LaneRecord> StartRecords() const ABSL_LOCKS_EXCLUDED(mu_);
  int permits() const ABSL_LOCKS_EXCLUDED(mu_);
  int64_t lapsed() const ABSL_LOCKS_EXCLUDED(mu_);
  int64_t resets() const ABSL_LOCKS_EXCLUDED(mu_);
  int64_t differing() const ABSL_LOCKS_EXCLUDED(mu_);
  int64_t dropped() const ABSL_LOCKS_EXCLUDED(mu_);
  // The run is over: actors are told to leave.
  void Finish() ABSL_LOCKS_EXCLUDED(mu_);
  // The learner stops before the end of the run: nothing more is granted and every waiting call returns.
  void Close() ABSL_LOCKS_EXCLUDED(mu_);
  // Waits until every actor has left, at most `timeout`.
  void WaitUntilEmpty(absl::Duration timeout) ABSL_LOCKS_EXCLUDED(mu_);

  // -- Evaluations: see EvaluationScheduler.

  void AddEvaluation(Evaluation evaluation) ABSL_LOCKS_EXCLUDED(mu_);
  std::shared_ptr<const std::string> EvaluationWeights(int64_t task) const ABSL_LOCKS_EXCLUDED(mu_);
  // The result of an actor.   Aborted: the actor is unknown or has left, and must join (again).
  absl::Status FinishEvaluation(absl::string_view actor, int64_t task, absl::Span<const Episode> episodes)
      ABSL_LOCKS_EXCLUDED(mu_);
  // Waits up to `timeout` until the oldest evaluation is finished. PopEvaluation removes it.
  std::optional<FinishedEvaluation> FrontEvaluation(absl::Duration timeout) ABSL_LOCKS_EXCLUDED(mu_);
  void PopEvaluation() ABSL_LOCKS_EXCLUDED(mu_);
  std::vector<Evaluation> PendingEvaluations() const ABSL_LOCKS_EXCLUDED(mu_);
  size_t pending_evaluations() const ABSL_LOCKS_EXCLUDED(mu_);

 private:
  using Key = std::pair<WorkerRole, std::string>;

  // How long an actor's report on a server holds: longer than a lease, since actors report their servers in turn.
  static constexpr absl::Duration kRelayed = absl::Seconds(10);

  // worker_registry.cc: records.
  Worker* Find(WorkerRole role, absl::string_view name) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // The active actor of that name, or null.
  Worker* FindActor(absl::string_view name) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // The active worker of that name or address.   NotFound: as Drain.
  absl::StatusOr<Worker*> FindActive(absl::string_view name_or_address) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // The worker's record; adds one if there is none.
  Worker* Record(WorkerRole role, absl::string_view name) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // The record of the worker that `client` calls as.   Errors as UseName.
  absl::StatusOr<Worker*> Own(WorkerRole role, absl::string_view name, const WorkerClient& client)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  absl::Status CheckAddress(absl::string_view name, absl::string_view address, const WorkerClient& client)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // Adds `client`'s claim to one more name.   ResourceExhausted: as UseName.
  absl::Status CountName(WorkerRole role, absl::string_view name, const WorkerClient& client)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  bool IsOwned(const Worker& worker) const;
  void ReleaseName(Worker* worker) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void Erase(Worker* worker) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // Frees lapsed names and erases records that are no longer needed: those of workers gone long ago, and the oldest
  // beyond the limits. Scans all records.
  void Prune() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // Notes that a record is about to be added, which is when the registry grows; prunes once a kPruneParts-th of all
  // records were added, and after kPruneEvery.
  void PruneSometimes() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // As BuildCheck::Check; also forgets the oldest differing workers beyond kMaxRefused.
  absl::Status CheckBuild(const WorkerBuild& build, Worker* worker) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  Health HealthOf(const Worker& worker) const { return HealthOf(worker, clock_->Now()); }
  Health HealthOf(const Worker& worker, absl::Time now) const;
  // Whether a status page shows the worker; sets `info` but for the worker's record and its play.
  bool IsShown(const Worker& worker, absl::Time now, WorkerInfo* info) const;
  // `info` of IsShown.
  Glance GlanceAt(const Worker& worker, const WorkerInfo& info) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // Records a report by the worker itself. A null `summary` keeps the last one.
  void NoteReport(Worker* worker, std::shared_ptr<const v1::ProcessSummary> summary) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);

  // registry_servers.cc: environment servers.
  // Records an actor's report. For servers that report themselves, only `hangs` is used.
  void NoteServer(const ServerReport& report) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // The actor can't use the server at `address`.
  void NoteUnusable(const std::string& address, Worker* actor) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // Whether the actor has been unable to use each of `addresses` for a while.
  bool LacksServers(const Worker& actor, const std::set<std::string>& addresses) const
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // Makes `server` the active one at `address`.
  void PlaceServer(Worker* server, absl::string_view address) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  absl::Duration ServerLease() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // How long a request for permits should wait while there is nothing to grant: longer where there are more than 1,000
  // actors, so that no more than kPollsPerSecond requests come for nothing, up to kLongestPoll.
  absl::Duration PollInterval() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // The lease of actors that report now. Requests that wait longer have a longer one.
  absl::Duration ActorLease() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // Makes `server` inactive.
  void RemoveServer(Worker* server) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // Lets lists have `server`, or no longer, by its state.
  void ListServer(const Worker& server) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // An actor has reported that `server` is slow.
  void NoteSlow(double step_ms, Worker* server) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void AddServerList(const PermitRequest& request, Worker* actor, PermitReply* reply)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void ExpireServers() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // The same, at most once a second, since there may be thousands of servers.
  void ExpireServersSometimes() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);

  // registry_play.cc: permits and evaluations.
  // Makes `actor` inactive and frees its permits and evaluations.
  void RemoveActor(Worker* actor) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void ExpireActors() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // The parts of GetPermits. Notes failures and renews the actor's lease, permits and evaluation.   Errors as
  // GetPermits.
  absl::Status ReportAndRenew(const PermitRequest& request, PermitReply* reply) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // Grants what there is. Returns whether the request need not wait longer.
  bool TryGrant(const PermitRequest& request, PermitReply* reply) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // Notes the rest of the request and fills in the rest of the reply.   Errors as GetPermits.
  absl::StatusOr<PermitReply> Complete(const PermitRequest& request, PermitReply reply)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // Renews the actor's lease and permits; returns the permits that it has lost.
  //   Aborted: the actor is unknown.
  absl::StatusOr<std::vector<Permit>> RenewPlay(const PermitRequest& request) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // Wakes calls of `actor` that wait for permits; empty: all, and those that wait for the last actor to leave.
  void Wake(absl::string_view actor = "") ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // The same if there may be new permits.
  void WakeIfChanged() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);

  const Options options_;
  Clock* const clock_;
  const absl::Time start_;
  const int64_t first_generation_;  // the date in microseconds, so that it exceeds those of earlier starts

  mutable Mutex mu_;
  CondVar changed_;    // permits, or the run is over
  CondVar evaluated_;  // an evaluation task is over
  Observer observer_ ABSL_GUARDED_BY(mu_);
  std::map<Key, Worker> workers_ ABSL_GUARDED_BY(mu_);
  std::map<std::string, size_t> names_of_ ABSL_GUARDED_BY(mu_);  // owned names, by identity
  std::map<std::pair<std::string, std::string>, int> names_from_
      ABSL_GUARDED_BY(mu_);  // the same, by identity and host
  std::map<std::string, Worker*, std::less<>> servers_
      ABSL_GUARDED_BY(mu_);                 // those that report themselves, by address
  ServerLists lists_ ABSL_GUARDED_BY(mu_);  // of the active servers
  absl::Time servers_checked_ ABSL_GUARDED_BY(mu_) = absl::InfinitePast();
  size_t added_ ABSL_GUARDED_BY(mu_) = 0;  // records since the last Prune
  absl::Time pruned_ ABSL_GUARDED_BY(mu_) = absl::InfinitePast();
  int reported_ ABSL_GUARDED_BY(mu_) = 0;  // records made from actors' reports
  LaneScheduler lanes_ ABSL_GUARDED_BY(mu_);
  EvaluationScheduler evaluations_ ABSL_GUARDED_BY(mu_);
  BuildCheck builds_ ABSL_GUARDED_BY(mu_);
  bool finished_ ABSL_GUARDED_BY(mu_) = false;
  bool closed_ ABSL_GUARDED_BY(mu_) = false;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_SCHEDULING_WORKER_REGISTRY_H_
