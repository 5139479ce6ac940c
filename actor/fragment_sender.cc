#include "actor/fragment_sender.h"

#include <utility>

#include <absl/strings/str_cat.h>
#include <absl/time/clock.h>

#include "common/backoff.h"
#include "common/log.h"
#include "common/status_macros.h"
#include "common/wire/convert.h"
#include "common/wire/grpc_status.h"

namespace craftfleet {
namespace {

constexpr absl::Duration kFirstPause = absl::Milliseconds(250);  // before the next stream
constexpr absl::Duration kLastPause = absl::Seconds(2);
constexpr absl::Duration kSayAgain = absl::Seconds(10);  // between two lines about the same trouble

HeldPermit PermitOf(const v1::FragmentMessage& message) {
  return {message.epoch(), message.lane(), message.number(), message.policy_version()};
}

}  // namespace

FragmentSender::FragmentSender(const LearnerClient* learner, std::string actor, PermitBook* permits)
    : learner_(learner), actor_(std::move(actor)), permits_(permits) {}

FragmentSender::~FragmentSender() { Stop(); }

void FragmentSender::Start() {
  thread_ = std::thread([this] { Run(); });
}

void FragmentSender::Stop() {
  queue_.Close();
  Cancel();
  if (thread_.joinable()) thread_.join();
}

void FragmentSender::Run() {
  Backoff backoff(kFirstPause, kLastPause);
  while (true) {
    const int64_t verdicts = accepted_ + refused_;
    std::unique_ptr<Stream> stream;
    {
      MutexLock lock(&mu_);
      if (stopping()) return;
      context_ = std::make_unique<grpc::ClientContext>();
      stream = learner_->PushFragments(context_.get());
    }
    absl::Status status = Serve(stream.get());
    // After a wrong verdict the stream is still open.
    if (absl::IsInternal(status)) Cancel();
    const absl::Status end = wire::FromGrpc(stream->Finish(), learner_->name());
    if (absl::IsUnavailable(status) && !end.ok()) status = end;  // says why the stream broke
    if (!stopping()) Explain(status);
    if (accepted_ + refused_ > verdicts) backoff.Reset();
    MutexLock lock(&mu_);
    context_ = nullptr;
    stopped_.WaitFor(&mu_, backoff.Next(), [this] { return stopping(); });
  }
}

void FragmentSender::Cancel() {
  MutexLock lock(&mu_);
  if (context_ != nullptr) context_->TryCancel();
  stopped_.NotifyAll();
}

void FragmentSender::Explain(const absl::Status& why) {
  if (absl::IsInvalidArgument(why) && unanswered_.has_value()) {
    LogError("%s; the fragment is dropped: run programs of one version", why.message());
    permits_->Release(PermitOf(*unanswered_));
    unanswered_.reset();
    ++refused_;
  } else if (absl::Now() - said_ > kSayAgain) {
    said_ = absl::Now();
    LogWarning("%s; fragments wait and will be sent again", why.message());
  }
}

absl::Status FragmentSender::Serve(Stream* stream) {
  if (unanswered_.has_value()) {
    ++resent_;
    CRAFTFLEET_RETURN_IF_ERROR(SendAndHear(stream));
  }
  while (true) {
    std::optional<Fragment> fragment = queue_.Pop(absl::InfiniteDuration());
    if (!fragment.has_value()) return absl::CancelledError("stopping");
    unanswered_ = wire::ToProto(*std::move(fragment));
    unanswered_->set_actor(actor_);
    CRAFTFLEET_RETURN_IF_ERROR(SendAndHear(stream));
  }
}

absl::Status FragmentSender::SendAndHear(Stream* stream) {
  v1::FragmentVerdict verdict;
  if (!stream->Write(*unanswered_) || !stream->Read(&verdict))
    return absl::UnavailableError(learner_->name() + ": the stream of fragments broke");
  if (verdict.lane() != unanswered_->lane() || verdict.number() != unanswered_->number()) {
    return absl::InternalError(absl::StrCat("verdict on fragment ", verdict.number(), " of lane ", verdict.lane(),
                                            ", want fragment ", unanswered_->number(), " of lane ",
                                            unanswered_->lane()));
  }
  ++(verdict.verdict() == v1::FragmentVerdict::EXPIRED ? refused_ : accepted_);
  permits_->Release(PermitOf(*unanswered_));
  unanswered_.reset();
  return absl::OkStatus();
}

}  // namespace craftfleet
