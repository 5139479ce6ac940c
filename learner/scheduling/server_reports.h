// What actors report on environment servers.

#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <set>
#include <string>

#include <absl/time/time.h>

#include "common/base/clock.h"
#include "learner/scheduling/server_lists.h"
#include "learner/scheduling/worker.h"
#include "learner/scheduling/worker_table.h"

namespace craftfleet {

// An actor's report on an environment server.
struct ServerReport {
  std::string address;
  bool answers = false;                               // the actor reaches it
  bool hangs = false;                                 // it is connected but does not answer
  std::shared_ptr<const v1::ProcessSummary> summary;  // null: none
  bool slow = false;                                  // it answers, but slowly
  double step_ms = 0;                                 // then: typical time of a step there
};

// Notes actors' reports in the servers' records, and gives other servers to an actor that can use none of its list.
// Not thread-safe.
class ServerReports {
 public:
  static constexpr int kMaxReported = 1024;  // servers known from actors' reports; further reports are ignored

  // Lists of generations below `first_generation`, or above all of this start's, are from an earlier start of the
  // learner: an actor keeps such a list until every server has had `server_lease` to register again. The pointers
  // outlive it.
  ServerReports(int64_t first_generation, absl::Duration server_lease, WorkerTable* workers, Clock* clock)
      : first_generation_(first_generation),
        server_lease_(server_lease),
        workers_(workers),
        clock_(clock),
        start_(clock->Now()) {}

  // Records a report. For servers that report themselves, only `hangs` and `slow` are used.
  void Add(const ServerReport& report);
  // The actor can't use the server at `address`.
  void AddUnusable(const std::string& address, Worker* actor);
  // The list of an actor that has that of `generation` (0: none), if it is to have another.
  std::optional<ServerLists::List> NewList(int64_t generation, Worker* actor);

 private:
  void NoteSlow(double step_ms, Worker* server);
  // The record of a server that does not report itself; null: there are too many.
  Worker* RecordOf(const std::string& address);
  // Whether the actor has been unable to use each of `addresses` for a while.
  bool LacksServers(const Worker& actor, const std::set<std::string>& addresses) const;

  const int64_t first_generation_;
  const absl::Duration server_lease_;
  WorkerTable* const workers_;
  Clock* const clock_;
  const absl::Time start_;
};

}  // namespace craftfleet
