// What an actor does about each error of those that it calls: one table, which README.md repeats.

#ifndef CRAFTFLEET_ACTOR_ERROR_POLICY_H_
#define CRAFTFLEET_ACTOR_ERROR_POLICY_H_

#include <string>

#include <absl/status/status.h>
#include <absl/strings/string_view.h>
#include <absl/types/span.h>

namespace craftfleet {

// What was asked for.
enum class Called {
  kJoin,      // of the learner, like all but the last
  kPermits,   // and results of evaluations
  kPush,      // fragments
  kWeights,   // and what is made of them
  kSnapshot,  // where a lane's fragment begins
  kSession,   // of an environment server: hello, open, step or close
};
inline constexpr int kNumCalled = 6;

enum class Reaction {
  kRetry,         // try again with growing pauses; what it was needed for is given back meanwhile
  kJoinAgain,     // forget what waits, and join
  kDropFragment,  // the learner will not have it: its permit is given back, the next one is sent
  kOtherServer,   // its games go on elsewhere from their snapshots; it is tried again with growing pauses
  kLeaveAlone,    // the same, but first it has to answer a probe (server_health.h)
  kUnfit,         // as kOtherServer; where each of a fixed list of servers is unfit, the program ends
  kEnd,           // the program ends with the error, exit code 1
};

// A row of the table.
struct ErrorRule {
  absl::StatusCode code;
  Reaction reactions[kNumCalled];  // by Called
  absl::string_view why;
};

// Every code but OK, in the order of their numbers.
absl::Span<const ErrorRule> ErrorPolicy();

// What to do about `error`, which is not ok, of `called`.
Reaction ReactionTo(Called called, const absl::Status& error);

// Whether waiting may mend it: any reaction but kEnd and kUnfit.
bool MayPass(Called called, const absl::Status& error);

// The table as it stands in README.md.
std::string FormatErrorPolicy();

}  // namespace craftfleet

#endif  // CRAFTFLEET_ACTOR_ERROR_POLICY_H_
