// The actor's reaction to each error of its calls, in one place.

#pragma once

#include <absl/status/status.h>

namespace craftfleet {

// The kinds of calls.
enum class CallKind {
  kJoin,      // to the learner, like all but the last
  kPlay,      // permits and fragments; also results of evaluations
  kWeights,   // also making a policy of them
  kSnapshot,  // of a lane before a fragment
  kSession,   // to an environment server: hello, open, step or close
};

enum class Reaction {
  kRetry,        // try again with growing pauses; permits that depend on the call are released
  kJoinAgain,    // drop the waiting permits and fragments, and join
  kOtherServer,  // the games continue elsewhere from their snapshots; the server is tried again with growing pauses
  kProbeFirst,   // the same, but the server must answer a probe first (server_health.h)
  kUnfit,        // as kOtherServer; if every server of a fixed list is unfit, the program ends
  kEnd,          // the program ends with the error, exit code 1
};

// The reaction to `error`, which is not ok, of a call.
Reaction ReactionTo(CallKind call, const absl::Status& error);

// Whether the same call may succeed later: any reaction but kEnd and kUnfit.
bool IsTransient(CallKind call, const absl::Status& error);

}  // namespace craftfleet
