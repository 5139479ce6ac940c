#include "actor/error_policy.h"

#include <algorithm>
#include <iterator>

#include <absl/strings/str_cat.h>

#include "common/check.h"

namespace craftfleet {
namespace {

using Code = absl::StatusCode;

constexpr Reaction kRetry = Reaction::kRetry;
constexpr Reaction kJoin = Reaction::kJoinAgain;
constexpr Reaction kDrop = Reaction::kDropFragment;
constexpr Reaction kOther = Reaction::kOtherServer;
constexpr Reaction kAlone = Reaction::kLeaveAlone;
constexpr Reaction kUnfit = Reaction::kUnfit;
constexpr Reaction kEnd = Reaction::kEnd;

constexpr absl::string_view kCalledNames[kNumCalled] = {"join", "permits", "push", "weights", "snapshot", "session"};

// An environment server is one of many and may lie: none of its answers ends the program but that it does not fit, and
// that only where there is no other and none can come. The learner is the one that an actor works for: an answer that
// can only mean "you are not my actor" ends it.
constexpr ErrorRule kTable[] = {
    {Code::kCancelled,
     {kRetry, kRetry, kRetry, kRetry, kRetry, kOther},
     "The other end is stopping. (When we stop ourselves nobody asks.)"},
    {Code::kUnknown, {kRetry, kRetry, kRetry, kRetry, kRetry, kOther}, "So gRPC calls an exception at the other end."},
    {Code::kInvalidArgument,
     {kEnd, kEnd, kDrop, kEnd, kEnd, kAlone},
     "The learner finds our request wrong, or we its weights: the same once more changes nothing. Of a server it is "
     "nonsense, since our requests are right."},
    {Code::kDeadlineExceeded,
     {kRetry, kRetry, kRetry, kRetry, kRetry, kAlone},
     "The learner is slow or away. A server that takes that long over a step hangs."},
    {Code::kNotFound,
     {kEnd, kEnd, kRetry, kEnd, kEnd, kAlone},
     "Nobody here answers so: another program, or a later version."},
    {Code::kAlreadyExists,
     {kEnd, kEnd, kRetry, kEnd, kEnd, kAlone},
     "Nobody here answers so: another program, or a later version."},
    {Code::kPermissionDenied,
     {kEnd, kRetry, kRetry, kRetry, kRetry, kUnfit},
     "At first the token is the wrong one. Later it or its rights are being replaced: the new one is tried as soon as "
     "it is there."},
    {Code::kResourceExhausted,
     {kRetry, kRetry, kRetry, kRetry, kRetry, kOther},
     "The other end sheds load, or an answer was too large."},
    {Code::kFailedPrecondition,
     {kEnd, kEnd, kRetry, kEnd, kEnd, kUnfit},
     "Another protocol version, run or textures, or a build that a synchronous run refuses: a person must choose."},
    {Code::kAborted,
     {kRetry, kJoin, kRetry, kRetry, kRetry, kOther},
     "Things moved on: the learner restarted or forgot us, the lane or the weights are further, a game failed within."},
    {Code::kOutOfRange,
     {kEnd, kEnd, kRetry, kEnd, kEnd, kAlone},
     "Nobody here answers so: another program, or a later version."},
    {Code::kUnimplemented,
     {kEnd, kEnd, kRetry, kEnd, kEnd, kUnfit},
     "Another program, or an older one, listens there."},
    {Code::kInternal,
     {kRetry, kRetry, kRetry, kRetry, kRetry, kAlone},
     "HTTP/2 broke on the way, which passes, or the other end is broken, which a person sees in the log."},
    {Code::kUnavailable, {kRetry, kRetry, kRetry, kRetry, kRetry, kOther}, "Not there, restarting, or cut off."},
    {Code::kDataLoss,
     {kEnd, kEnd, kRetry, kEnd, kEnd, kAlone},
     "So we call an answer that can't be (learner_replies.h, play_reply.h)."},
    {Code::kUnauthenticated, {kEnd, kRetry, kRetry, kRetry, kRetry, kUnfit}, "As PERMISSION_DENIED."},
};

absl::string_view NameOf(Reaction reaction) {
  switch (reaction) {
    case Reaction::kRetry:
      return "retry";
    case Reaction::kJoinAgain:
      return "join again";
    case Reaction::kDropFragment:
      return "drop fragment";
    case Reaction::kOtherServer:
      return "other server";
    case Reaction::kLeaveAlone:
      return "leave alone";
    case Reaction::kUnfit:
      return "unfit";
    case Reaction::kEnd:
      break;
  }
  return "**end**";
}

}  // namespace

absl::Span<const ErrorRule> ErrorPolicy() { return kTable; }

Reaction ReactionTo(Called called, const absl::Status& error) {
  const auto rule =
      std::find_if(std::begin(kTable), std::end(kTable), [&](const ErrorRule& r) { return r.code == error.code(); });
  CRAFTFLEET_CHECK(rule != std::end(kTable));
  return rule->reactions[static_cast<int>(called)];
}

bool MayPass(Called called, const absl::Status& error) {
  const Reaction reaction = ReactionTo(called, error);
  return reaction != Reaction::kEnd && reaction != Reaction::kUnfit;
}

std::string FormatErrorPolicy() {
  std::string text = "| Error |";
  for (const absl::string_view called : kCalledNames) absl::StrAppend(&text, " ", called, " |");
  absl::StrAppend(&text, " Why |\n|---|---|---|---|---|---|---|---|\n");
  for (const ErrorRule& rule : kTable) {
    absl::StrAppend(&text, "| ", absl::StatusCodeToString(rule.code), " |");
    for (const Reaction reaction : rule.reactions) absl::StrAppend(&text, " ", NameOf(reaction), " |");
    absl::StrAppend(&text, " ", rule.why, " |\n");
  }
  return text;
}

}  // namespace craftfleet
