// The records of all workers: who owns a name, who is there, and when they are forgotten.

#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>
#include <absl/time/time.h>

#include "common/base/clock.h"
#include "learner/scheduling/server_lists.h"
#include "learner/scheduling/worker.h"

namespace craftfleet {

enum class WorkerHealth { kOk, kLost, kLeft, kNotAnswering, kSlow };

// Keeps one record of each actor and environment server, and the lists of the servers that are there.
//
// Names: the first identity (common/wire/access.h) to use a name, or a server's address, owns it until the worker
// leaves or the name has not been used for `name_lapse`. Without TLS all workers have the same identity, so this has no
// effect.
//
// Environment servers: one per address. A server that registers an address already in use replaces the earlier server,
// which must be gone.
//
// Records outlive their workers for a while, so that status pages show missing workers. Not thread-safe.
class WorkerTable {
 public:
  static constexpr absl::Duration kRememberLost = absl::Minutes(10);  // of lost and refused workers
  static constexpr absl::Duration kRememberLeft = absl::Minutes(1);
  static constexpr size_t kMaxGone = 64;      // lost workers and those that left; the newest are kept
  static constexpr size_t kMaxRefused = 16;   // workers with another canary; the newest are kept
  static constexpr size_t kMaxNames = 16384;  // owned by one identity at a time, from all hosts
  // How long an actor's report on a server holds: longer than a lease, since actors report their servers in turn.
  static constexpr absl::Duration kRelayed = absl::Seconds(10);

  struct Options {
    absl::Duration name_lapse = absl::Seconds(20);  // at least twice the longest lease of an actor
    int max_names_per_client = 2048;                // owned by one identity from one host at a time
  };
  using Key = std::pair<WorkerRole, std::string>;

  // `generation`: see ServerLists. `clock` outlives the table.
  WorkerTable(const Options& options, absl::Duration actor_lease, int64_t generation, Clock* clock)
      : options_(options), actor_lease_(actor_lease), clock_(clock), lists_(generation) {}

  const std::map<Key, Worker>& workers() const { return workers_; }
  // Null: no such worker.
  Worker* Find(WorkerRole role, absl::string_view name);
  Worker* FindActiveActor(absl::string_view name);
  // The server that has registered this address; it may be gone.
  Worker* FindServer(absl::string_view address);
  // The active worker of that name or address.   NotFound: there is none; lists the active ones.
  absl::StatusOr<Worker*> FindActive(absl::string_view name_or_address);
  // The worker's record; adds one if there is none.
  Worker* Record(WorkerRole role, absl::string_view name);

  // The record of the worker that `client` calls as. A lapsed name's record is erased.
  //   PermissionDenied: another identity owns the name.   ResourceExhausted: the identity already has kMaxNames names,
  //   or `max_names_per_client` from this host.
  absl::StatusOr<Worker*> Own(WorkerRole role, absl::string_view name, const WorkerClient& client);
  // Whether the record of `name` is of another identity that no longer owns it.
  bool IsForfeit(WorkerRole role, absl::string_view name, const WorkerClient& client) const;
  // PermissionDenied: another identity owns the address of a server.
  absl::Status CheckAddress(absl::string_view name, absl::string_view address, const WorkerClient& client);

  // Makes `server` the active one at `address`.
  void PlaceServer(Worker* server, absl::string_view address);
  // Makes `server` inactive.
  void RemoveServer(Worker* server);
  // Makes the servers inactive whose lease has expired.
  void ExpireServers();
  // Lets lists have `server`, or no longer, by its state.
  void ListServer(const Worker& server);
  ServerLists& lists() { return lists_; }
  const ServerLists& lists() const { return lists_; }

  // Records a report by the worker itself. A null `summary` keeps the last one.
  void NoteReport(Worker* worker, std::shared_ptr<const v1::ProcessSummary> summary);
  WorkerHealth HealthOf(const Worker& worker) const;
  // Forgets the oldest workers with another canary beyond kMaxRefused.
  void ForgetRefused();
  // Frees lapsed names and erases records that are no longer needed: those of workers gone long ago, and the oldest
  // beyond the limits.
  void Prune();

 private:
  // ResourceExhausted: as Own.
  absl::Status CheckRoomForName(WorkerRole role, absl::string_view name, const WorkerClient& client) const;
  bool IsOwned(const Worker& worker) const;
  void Erase(Worker* worker);

  const Options options_;
  const absl::Duration actor_lease_;
  Clock* const clock_;
  std::map<Key, Worker> workers_;
  std::map<std::string, Worker*, std::less<>> servers_;  // those that have registered, by address; some are gone
  ServerLists lists_;                                    // of the active servers
  absl::Time pruned_ = absl::InfinitePast();
};

}  // namespace craftfleet
