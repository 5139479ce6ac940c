#include "actor/learner_stream.h"

#include <utility>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>

#include "actor/play_reply.h"
#include "common/base/clock.h"
#include "common/telemetry/log.h"
#include "common/wire/convert.h"

namespace craftfleet {
namespace {

// For the reply to a request, beyond the time that it may wait: users should see an error within 5 s. On a slow link it
// comes after the fragments that were written before the request.
constexpr absl::Duration kReplyTimeout = absl::Seconds(4);
constexpr absl::Duration kReplyBehindFragmentsTimeout = absl::Minutes(1);

HeldPermit PermitOf(const v1::FragmentMessage& message) {
  return {{message.lane(), message.number(), message.policy_version()}, message.epoch()};
}

}  // namespace

LearnerStream::LearnerStream(const LearnerClient* learner, std::string actor, PermitTracker* permits)
    : learner_(learner), actor_(std::move(actor)), permits_(permits) {}

LearnerStream::~LearnerStream() { Stop(); }

void LearnerStream::Start() {
  thread_ = std::thread([this] { Run(); });
}

absl::StatusOr<v1::PermitReply> LearnerStream::Ask(const v1::PermitRequest& request) {
  auto message = std::make_shared<v1::ActorMessage>();
  *message->mutable_permits() = request;
  const MutexLock lock(&mu_);
  request_ = std::move(message);
  changed_.NotifyAll();
  const auto settled = [this]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) {
    return stopping_ || reply_.has_value() || !failure_.ok();
  };
  const absl::Duration timeout =
      absl::Milliseconds(request.wait_ms()) + (written_ == 0 ? kReplyTimeout : kReplyBehindFragmentsTimeout);
  while (!changed_.WaitFor(&mu_, timeout, settled)) {
    Break(absl::DeadlineExceededError(
        absl::StrFormat("%s: no answer within %s", learner_->name(), absl::FormatDuration(timeout))));
  }
  request_ = nullptr;
  if (stopping_) return absl::CancelledError("stopping");
  if (reply_.has_value()) return *std::exchange(reply_, std::nullopt);
  return std::exchange(failure_, absl::OkStatus());
}

absl::Status LearnerStream::Push(Fragment fragment) {
  const MutexLock lock(&mu_);
  changed_.Wait(&mu_,
                [this]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) { return stopping_ || waiting_.size() < kQueueCapacity; });
  if (stopping_) return absl::CancelledError("stopping");
  waiting_.push_back(std::move(fragment));
  changed_.NotifyAll();
  return absl::OkStatus();
}

void LearnerStream::DropWaiting() {
  const MutexLock lock(&mu_);
  for (const Fragment& fragment : waiting_) {
    permits_->Release({{fragment.lane, fragment.number, fragment.policy_version}, fragment.epoch});
  }
  waiting_.clear();
  changed_.NotifyAll();
}

void LearnerStream::Cancel() {
  const MutexLock lock(&mu_);
  stopping_ = true;
  Break(absl::CancelledError("stopping"));
  changed_.NotifyAll();
}

void LearnerStream::Stop() {
  Cancel();
  if (thread_.joinable()) thread_.join();
}

void LearnerStream::Break(const absl::Status& why) {
  if (context_ == nullptr) return;
  if (broken_.ok()) broken_ = why;
  context_->TryCancel();
}

void LearnerStream::Run() {
  while (true) {
    grpc::ClientContext* context = nullptr;
    {
      const MutexLock lock(&mu_);
      changed_.Wait(&mu_, [this]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) { return stopping_ || request_ != nullptr; });
      if (stopping_) return;
      context_ = std::make_unique<grpc::ClientContext>();
      context = context_.get();
    }
    absl::Status status = Serve(context);
    const MutexLock lock(&mu_);
    failure_ = !broken_.ok() ? broken_ : std::move(status);
    request_ = nullptr;  // its caller learns of the failure, and asks anew
    broken_ = absl::OkStatus();
    context_ = nullptr;
    written_ = 0;
    asked_ = false;
    ended_ = false;
    changed_.NotifyAll();
  }
}

absl::Status LearnerStream::Serve(grpc::ClientContext* context) {
  const std::unique_ptr<Stream> stream = learner_->Play(context);
  std::thread reader([&] { Read(stream.get()); });
  for (Message message = NextToWrite(); message != nullptr && stream->Write(*message); message = NextToWrite()) {
  }
  reader.join();
  const absl::Status status = learner_->FromCall(stream->Finish());
  return status.ok() ? absl::UnavailableError(learner_->name() + ": ended the stream") : status;
}

LearnerStream::Message LearnerStream::NextToWrite() {
  const MutexLock lock(&mu_);
  changed_.Wait(&mu_, [this]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) {
    return stopping_ || ended_ || request_ != nullptr || written_ < under_way_.size() ||
           (!waiting_.empty() && under_way_.size() < kMaxUnderWay);
  });
  if (stopping_ || ended_) return nullptr;
  if (request_ != nullptr) {
    asked_ = true;
    return std::exchange(request_, nullptr);
  }
  if (written_ < under_way_.size()) {
    ++resent_;
  } else {
    auto message = std::make_shared<v1::ActorMessage>();
    *message->mutable_fragment() = wire::ToProto(std::move(waiting_.front()));
    message->mutable_fragment()->set_actor(actor_);
    under_way_.push_back(std::move(message));
    waiting_.pop_front();
    changed_.NotifyAll();
  }
  return under_way_[written_++];
}

void LearnerStream::Read(Stream* stream) {
  absl::Status status;
  v1::LearnerMessage message;
  while (status.ok() && stream->Read(&message)) status = Take(&message);
  const MutexLock lock(&mu_);
  ended_ = true;
  if (!status.ok()) Break(status);  // the stream is still open, and the writer may be blocked in it
  changed_.NotifyAll();
}

absl::Status LearnerStream::Take(v1::LearnerMessage* message) {
  const MutexLock lock(&mu_);
  if (message->has_verdict()) return TakeVerdict(message->verdict());
  if (!message->has_permits() || !std::exchange(asked_, false)) {
    return absl::InternalError(learner_->name() + ": an answer that was not asked for");
  }
  reply_ = std::move(*message->mutable_permits());
  changed_.NotifyAll();
  return absl::OkStatus();
}

absl::Status LearnerStream::TakeVerdict(const v1::FragmentVerdict& verdict) {
  const v1::FragmentMessage* const oldest = written_ > 0 ? &under_way_.front()->fragment() : nullptr;
  if (oldest == nullptr || verdict.lane() != oldest->lane() || verdict.number() != oldest->number()) {
    return absl::InternalError(absl::StrCat(learner_->name(), ": verdict on fragment ", verdict.number(), " of lane ",
                                            verdict.lane(), ", want that of the oldest fragment sent"));
  }
  switch (verdict.verdict()) {
    case v1::FragmentVerdict::ACCEPTED:
    case v1::FragmentVerdict::DUPLICATE:
      ++accepted_;
      break;
    case v1::FragmentVerdict::REFUSED:
      LogError("%s: %s; the fragment is dropped: the programs' versions differ, or training diverges", learner_->name(),
               CutReason(verdict.reason()));
      ++refused_;
      break;
    case v1::FragmentVerdict::EXPIRED:
      ++refused_;
      break;
    default:
      return absl::InternalError(absl::StrCat(learner_->name(), ": verdict ", verdict.verdict(), ", want 1..4"));
  }
  permits_->Release(PermitOf(*oldest));
  under_way_.pop_front();
  --written_;
  changed_.NotifyAll();
  return absl::OkStatus();
}

}  // namespace craftfleet
