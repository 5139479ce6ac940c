// LearnerServiceImpl: streams of fragments.
#include <optional>
#include <utility>

#include <absl/strings/str_format.h>

#include "common/base/printable.h"
#include "common/base/status_macros.h"
#include "common/wire/fragment_digest.h"
#include "common/wire/grpc_status.h"
#include "common/wire/protocol.h"
#include "common/wire/request_check.h"
#include "learner/learner_service.h"

namespace craftfleet {
namespace {

v1::FragmentVerdict::Verdict VerdictToProto(LaneScheduler::Verdict verdict) {
  switch (verdict) {
    case LaneScheduler::Verdict::kAccepted:
      return v1::FragmentVerdict::ACCEPTED;
    case LaneScheduler::Verdict::kDuplicate:
      return v1::FragmentVerdict::DUPLICATE;
    case LaneScheduler::Verdict::kExpired:
    case LaneScheduler::Verdict::kStale:
      return v1::FragmentVerdict::EXPIRED;
  }
  return v1::FragmentVerdict::VERDICT_UNSPECIFIED;
}

}  // namespace

// One call of PushFragments: reads a fragment, writes its verdict, and so on. gRPC calls one method at a time, and
// OnDone last.
class LearnerServiceImpl::FragmentStream final
    : public grpc::ServerBidiReactor<v1::FragmentMessage, v1::FragmentVerdict> {
 public:
  FragmentStream(LearnerServiceImpl* service, grpc::CallbackServerContext* context)
      : service_(service), context_(context), watched_(std::in_place, &service->streams_, context) {
    if (watched_->admitted().ok()) {
      ReadNext();
    } else {
      End(watched_->admitted());
    }
  }

  void OnReadDone(bool ok) override {
    if (!ok) return End(watched_->late());
    watched_->Work();
    const absl::StatusOr<v1::FragmentVerdict::Verdict> verdict = service_->Receive(*context_, &message_);
    if (!verdict.ok()) return End(verdict.status());
    reply_.set_lane(message_.lane());
    reply_.set_number(message_.number());
    reply_.set_verdict(*verdict);
    message_ = v1::FragmentMessage();  // a stream that waits must not keep megabytes of its last fragment
    watched_->Await("a verdict to be taken", service_->options_.reply_timeout);
    StartWrite(&reply_);
  }

  void OnWriteDone(bool ok) override {
    if (!ok) return End(watched_->late());
    ReadNext();
  }

  void OnDone() override { delete this; }

 private:
  // Frees the stream's place before the client learns that it has ended.
  void End(absl::Status status) {
    watched_.reset();
    Finish(wire::ToGrpc(status));
  }

  void ReadNext() {
    watched_->Await("a fragment", service_->options_.fragment_timeout);
    StartRead(&message_);
  }

  LearnerServiceImpl* const service_;
  grpc::CallbackServerContext* const context_;
  std::optional<wire::StreamWatch::Stream> watched_;  // until the call ends
  v1::FragmentMessage message_;
  v1::FragmentVerdict reply_;
};

grpc::ServerBidiReactor<v1::FragmentMessage, v1::FragmentVerdict>* LearnerServiceImpl::PushFragments(
    grpc::CallbackServerContext* context) {
  return new FragmentStream(this, context);
}

absl::StatusOr<v1::FragmentVerdict::Verdict> LearnerServiceImpl::Receive(const grpc::ServerContextBase& context,
                                                                         v1::FragmentMessage* message) {
  CRAFTFLEET_RETURN_IF_ERROR(NameActor(context, message->actor()));
  const absl::StatusOr<v1::FragmentVerdict::Verdict> verdict = Intake(message);
  if (verdict.status().code() != absl::StatusCode::kInvalidArgument) return verdict;
  ++rejected_;
  const absl::Status refused = absl::InvalidArgumentError(
      absl::StrFormat("fragment %d of lane %d of actor %s: %s", message->number(), message->lane(),
                      Printable(message->actor().substr(0, wire::kMaxTextBytes)), verdict.status().message()));
  WarnRefused(context, message->actor(), absl::StrFormat("fragment refused: %s", refused.message()));
  return refused;
}

absl::StatusOr<v1::FragmentVerdict::Verdict> LearnerServiceImpl::Intake(v1::FragmentMessage* message) {
  if (message->epoch() != options_.epoch) {
    ++expired_;
    return v1::FragmentVerdict::EXPIRED;
  }
  std::string scenes = message->frame_format() == v1::FRAMES_SCENE ? message->frames() : "";
  CRAFTFLEET_RETURN_IF_ERROR(frames_.Draw(options_.shape.steps, message));
  CRAFTFLEET_ASSIGN_OR_RETURN(Fragment fragment, wire::FromProto(message, options_.shape));
  fragment.scenes = std::move(scenes);
  fragment.sender = message->actor();
  fragment.digest = wire::FragmentDigest(fragment);
  CRAFTFLEET_ASSIGN_OR_RETURN(
      const LaneScheduler::Verdict verdict,
      registry_->Accept(fragment.sender, {fragment.lane, fragment.number, fragment.policy_version}, fragment.snapshot,
                        fragment.digest));
  if (verdict == LaneScheduler::Verdict::kAccepted) {
    ++accepted_;
    CRAFTFLEET_RETURN_IF_ERROR(fragments_->Push(std::move(fragment)));  // never full: it has room for all permits
  } else if (verdict != LaneScheduler::Verdict::kStale) {               // which the registry counts
    ++(verdict == LaneScheduler::Verdict::kDuplicate ? duplicates_ : expired_);
  }
  return VerdictToProto(verdict);
}

}  // namespace craftfleet
