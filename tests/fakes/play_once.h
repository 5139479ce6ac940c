// Single messages to a learner, each on a stream of its own. Such a stream is not broken when it ends, so the actor's
// lease goes on.

#pragma once

#include <utility>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/time/time.h>

#include "common/base/status_macros.h"
#include "common/wire/channel.h"
#include "common/wire/grpc_status.h"
#include "craftfleet/v1/learner.grpc.pb.h"

namespace craftfleet {

// The answer, or the status of a stream without one.
inline absl::StatusOr<v1::LearnerMessage> PlayOnce(v1::LearnerService::Stub* stub, const v1::ActorMessage& message) {
  grpc::ClientContext context;
  wire::SetDeadline(&context, absl::Seconds(20));
  context.set_wait_for_ready(true);
  const auto stream = stub->Play(&context);
  stream->Write(message);
  stream->WritesDone();
  v1::LearnerMessage answer;
  const bool answered = stream->Read(&answer);
  CRAFTFLEET_RETURN_IF_ERROR(wire::FromGrpc(stream->Finish(), "learner"));
  if (!answered) return absl::InternalError("no answer");
  return answer;
}

inline absl::StatusOr<v1::PermitReply> AskOnce(v1::LearnerService::Stub* stub, const v1::PermitRequest& request) {
  v1::ActorMessage message;
  *message.mutable_permits() = request;
  CRAFTFLEET_ASSIGN_OR_RETURN(v1::LearnerMessage answer, PlayOnce(stub, message));
  return std::move(*answer.mutable_permits());
}

inline absl::StatusOr<v1::FragmentVerdict> PushOnce(v1::LearnerService::Stub* stub, v1::FragmentMessage fragment) {
  v1::ActorMessage message;
  *message.mutable_fragment() = std::move(fragment);
  CRAFTFLEET_ASSIGN_OR_RETURN(v1::LearnerMessage answer, PlayOnce(stub, message));
  return std::move(*answer.mutable_verdict());
}

}  // namespace craftfleet
