// The learner's record of one worker.

#pragma once

#include <map>
#include <memory>
#include <optional>
#include <string>

#include <absl/time/time.h>

namespace craftfleet {

namespace v1 {
class ProcessSummary;
}  // namespace v1

enum class WorkerRole { kActor, kEnvServer };

// A worker's report about its program.
struct WorkerBuild {
  std::string build;   // version and git revision, for people
  std::string canary;  // digest of its numerics (actor) or game rules (environment server)
  std::string cpu = "";
};

// What the learner knows of the caller of a worker's calls.
struct WorkerClient {
  std::string identity = "";  // of its certificate (common/wire/access.h); empty: not known
  std::string host = "";      // the address that it calls from, without port (wire::ClientOfPeer)

  // What tells clients apart: the identity or, without one, the host.
  const std::string& Name() const { return identity.empty() ? host : identity; }
};

// Everything that is known about a worker, kept by WorkerRegistry under its mutex. Times are from the registry's
// clock; InfinitePast: never.
struct Worker {
  struct Mismatch {
    std::string build;  // printable
    absl::Time time;    // when its canary was last compared
  };

  WorkerRole role = WorkerRole::kActor;
  std::string name;
  std::string address;  // empty: not known

  // The owner of the name, and when the name was last used. It becomes free when unused for `name_lapse`.
  WorkerClient client;
  absl::Time name_used = absl::InfinitePast();

  // Has joined (actor) or registered (server), has not left, and its lease has not expired.
  bool active = false;
  absl::Duration lease;  // how long it counts as there after a report
  // Start of its lease: its last report, or earlier if its connection broke.
  absl::Time leased_from = absl::InfinitePast();
  // Actor: the stream of its last request for permits (PermitRequest.stream).
  int64_t stream = 0;
  // Gets no new permits, evaluations or games, until it leaves or is undrained.
  bool draining = false;
  bool empty = false;  // environment server: has reported no games since the drain began

  // Actor: the registered servers that it reports as not answering or not reachable, by address.
  struct Unusable {
    absl::Time since;
    absl::Time reported;
  };
  std::map<std::string, Unusable> unusable;

  absl::Time last_seen = absl::InfinitePast();   // last report by itself or, for a server, by an actor that reaches it
  absl::Time own_report = absl::InfinitePast();  // last report by itself
  absl::Time not_answering =
      absl::InfinitePast();                // environment server: last time an actor reported that it does not answer
  absl::Time slow = absl::InfinitePast();  // environment server: last time an actor reported that it is slow
  double step_ms = 0;                      // then: typical time of a step there
  bool left = false;                       // has reported that it leaves
  std::shared_ptr<const v1::ProcessSummary> summary;  // the last one; null: none
  absl::Time summary_time = absl::InfinitePast();

  std::optional<Mismatch> mismatch;  // its canary differs

  // Whether this is an environment server that only actors have told of.
  bool IsOnlyReported() const {
    return role == WorkerRole::kEnvServer && own_report == absl::InfinitePast() && name_used == absl::InfinitePast();
  }
};

}  // namespace craftfleet
