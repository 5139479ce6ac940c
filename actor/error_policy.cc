#include "actor/error_policy.h"

#include <algorithm>
#include <iterator>

#include "common/base/check.h"

namespace craftfleet {
namespace {

using Code = absl::StatusCode;

constexpr Reaction kRetry = Reaction::kRetry;
constexpr Reaction kJoin = Reaction::kJoinAgain;
constexpr Reaction kOther = Reaction::kOtherServer;
constexpr Reaction kProbe = Reaction::kProbeFirst;
constexpr Reaction kUnfit = Reaction::kUnfit;
constexpr Reaction kEnd = Reaction::kEnd;

// A row of the table.
struct ErrorRule {
  Code code;
  Reaction reactions[kNumCallKinds];  // by CallKind
};

// A row for every code but OK, in numerical order. There may be many environment servers, and some may misbehave. Their
// errors end the program only if every server of a fixed list is unfit. There is only one learner: errors that a retry
// cannot fix end the program.
constexpr ErrorRule kTable[] = {
    // The other end is stopping. (When the actor itself stops, this table is not used.)
    {Code::kCancelled, {kRetry, kRetry, kRetry, kRetry, kOther}},
    // gRPC reports an exception at the other end in this way.
    {Code::kUnknown, {kRetry, kRetry, kRetry, kRetry, kOther}},
    // The learner rejects the request, or the actor rejects the weights: a retry would not help. From a server it is an
    // invalid answer, since the requests are valid.
    {Code::kInvalidArgument, {kEnd, kEnd, kEnd, kEnd, kProbe}},
    // The learner is slow or unreachable. A server that takes this long for a step hangs.
    {Code::kDeadlineExceeded, {kRetry, kRetry, kRetry, kRetry, kProbe}},
    // This version never returns it: another program or a later version answered.
    {Code::kNotFound, {kEnd, kEnd, kEnd, kEnd, kProbe}},
    // This version never returns it: another program or a later version answered.
    {Code::kAlreadyExists, {kEnd, kEnd, kEnd, kEnd, kProbe}},
    // At the first join the token is wrong. Later the token or its rights are being replaced: the new token is used as
    // soon as it is available.
    {Code::kPermissionDenied, {kEnd, kRetry, kRetry, kRetry, kUnfit}},
    // The other end is overloaded, a server plays for another run at the moment, or an answer was too large.
    {Code::kResourceExhausted, {kRetry, kRetry, kRetry, kRetry, kOther}},
    // Another protocol version, run or textures, or a build that the run refuses: the user must fix it.
    {Code::kFailedPrecondition, {kEnd, kEnd, kEnd, kEnd, kUnfit}},
    // The state has changed: the learner restarted or dropped this actor, the lane or the weights have advanced, or a
    // game failed.
    {Code::kAborted, {kRetry, kJoin, kRetry, kRetry, kOther}},
    // This version never returns it: another program or a later version answered.
    {Code::kOutOfRange, {kEnd, kEnd, kEnd, kEnd, kProbe}},
    // Another program, or an older one, listens there.
    {Code::kUnimplemented, {kEnd, kEnd, kEnd, kEnd, kUnfit}},
    // A transient HTTP/2 failure, or a bug at the other end, which the log shows.
    {Code::kInternal, {kRetry, kRetry, kRetry, kRetry, kProbe}},
    // Not running, restarting, or cut off.
    {Code::kUnavailable, {kRetry, kRetry, kRetry, kRetry, kOther}},
    // An impossible answer (learner_replies.h, play_reply.h).
    {Code::kDataLoss, {kEnd, kEnd, kEnd, kEnd, kProbe}},
    // As PERMISSION_DENIED.
    {Code::kUnauthenticated, {kEnd, kRetry, kRetry, kRetry, kUnfit}},
};

}  // namespace

Reaction ReactionTo(CallKind call, const absl::Status& error) {
  const auto rule =
      std::find_if(std::begin(kTable), std::end(kTable), [&](const ErrorRule& r) { return r.code == error.code(); });
  CRAFTFLEET_CHECK(rule != std::end(kTable));
  return rule->reactions[static_cast<int>(call)];
}

bool IsTransient(CallKind call, const absl::Status& error) {
  const Reaction reaction = ReactionTo(call, error);
  return reaction != Reaction::kEnd && reaction != Reaction::kUnfit;
}

}  // namespace craftfleet
