#include "actor/fragment_sender.h"

#include <optional>
#include <utility>

#include <absl/strings/str_cat.h>

#include "common/log.h"
#include "common/status_macros.h"
#include "common/wire/convert.h"
#include "common/wire/grpc_status.h"

namespace craftfleet {
namespace {

constexpr absl::Duration kRetryPause = absl::Milliseconds(500);

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
  {
    MutexLock lock(&mu_);
    if (context_ != nullptr) context_->TryCancel();
    stopped_.NotifyAll();
  }
  if (thread_.joinable()) thread_.join();
}

void FragmentSender::Run() {
  while (true) {
    std::unique_ptr<Stream> stream;
    {
      MutexLock lock(&mu_);
      if (stopping()) return;
      context_ = std::make_unique<grpc::ClientContext>();
      stream = learner_->PushFragments(context_.get());
    }
    const absl::Status status = Serve(stream.get());
    // Ends the call; after an error of the stream this has its status.
    const absl::Status end = wire::FromGrpc(stream->Finish(), learner_->name());
    if (!stopping()) Explain(status, end);
    MutexLock lock(&mu_);
    context_ = nullptr;
    stopped_.WaitFor(&mu_, kRetryPause, [this] { return stopping(); });
  }
}

void FragmentSender::Explain(const absl::Status& status, const absl::Status& end) {
  if (end.code() == absl::StatusCode::kInvalidArgument && !unanswered_.empty()) {
    LogError("%s; the fragment is dropped", end.message());
    permits_->Release(PermitOf(unanswered_.front()));
    unanswered_.pop_front();
    ++refused_;
  } else {
    LogWarning("%s; %d fragments will be sent again", (end.ok() ? status : end).message(), unanswered_.size());
  }
}

absl::Status FragmentSender::Serve(Stream* stream) {
  for (const v1::FragmentMessage& message : unanswered_) {
    if (!stream->Write(message)) return absl::UnavailableError("stream to the learner broke");
    ++resent_;
  }
  while (true) {
    while (unanswered_.size() >= kWindow || (!unanswered_.empty() && queue_.size() == 0)) {
      CRAFTFLEET_RETURN_IF_ERROR(ReadVerdict(stream));
    }
    std::optional<Fragment> fragment = queue_.Pop(absl::InfiniteDuration());
    if (!fragment.has_value()) return absl::CancelledError("stopping");
    unanswered_.push_back(wire::ToProto(*std::move(fragment)));
    unanswered_.back().set_actor(actor_);
    if (!stream->Write(unanswered_.back())) return absl::UnavailableError("stream to the learner broke");
  }
}

absl::Status FragmentSender::ReadVerdict(Stream* stream) {
  v1::FragmentVerdict verdict;
  if (!stream->Read(&verdict)) return absl::UnavailableError("stream to the learner broke");
  const v1::FragmentMessage& message = unanswered_.front();
  if (verdict.lane() != message.lane() || verdict.number() != message.number()) {
    return absl::InternalError(absl::StrCat("verdict on fragment ", verdict.number(), " of lane ", verdict.lane(),
                                            ", want fragment ", message.number(), " of lane ", message.lane()));
  }
  ++(verdict.verdict() == v1::FragmentVerdict::EXPIRED ? refused_ : accepted_);
  permits_->Release(PermitOf(message));
  unanswered_.pop_front();
  return absl::OkStatus();
}

}  // namespace craftfleet
