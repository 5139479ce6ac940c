#include "actor/error_policy.h"

namespace craftfleet {

// There may be many environment servers, and some may misbehave: their errors end the program only if every server of a
// fixed list is unfit. There is only one learner: errors that a retry cannot fix end the program.
Reaction ReactionTo(CallKind call, const absl::Status& error) {
  using Code = absl::StatusCode;
  const bool to_server = call == CallKind::kSession;
  switch (error.code()) {
    // The other end is stopping, had an exception, is overloaded, or cannot be reached; a server plays for another run
    // at the moment; an answer was too large. (When the actor itself stops, this is not called.)
    case Code::kCancelled:
    case Code::kUnknown:
    case Code::kResourceExhausted:
    case Code::kUnavailable:
      return to_server ? Reaction::kOtherServer : Reaction::kRetry;
    // The learner is slow; a server that takes this long for a step hangs. Or a transient failure of HTTP/2, or a bug
    // at the other end, which the log shows.
    case Code::kDeadlineExceeded:
    case Code::kInternal:
      return to_server ? Reaction::kProbeFirst : Reaction::kRetry;
    // At the first join the actor has no right to it. Later the rights are being changed: the actor goes on as soon as
    // it has them again.
    case Code::kPermissionDenied:
    case Code::kUnauthenticated:
      if (to_server) return Reaction::kUnfit;
      return call == CallKind::kJoin ? Reaction::kEnd : Reaction::kRetry;
    // Another protocol version, run or textures, or a build that the run refuses; another program, or an older one,
    // listens there. The user must fix it.
    case Code::kFailedPrecondition:
    case Code::kUnimplemented:
      return to_server ? Reaction::kUnfit : Reaction::kEnd;
    // The state has changed: the learner restarted or dropped this actor, the lane or the weights have advanced, or a
    // game failed.
    case Code::kAborted:
      if (to_server) return Reaction::kOtherServer;
      return call == CallKind::kPlay ? Reaction::kJoinAgain : Reaction::kRetry;
    // The learner rejects the request, or the actor an answer (learner_replies.h, play_reply.h); or a code that this
    // version never returns. A retry would not help.
    default:
      return to_server ? Reaction::kProbeFirst : Reaction::kEnd;
  }
}

bool IsTransient(CallKind call, const absl::Status& error) {
  const Reaction reaction = ReactionTo(call, error);
  return reaction != Reaction::kEnd && reaction != Reaction::kUnfit;
}

}  // namespace craftfleet
