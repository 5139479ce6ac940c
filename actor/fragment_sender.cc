#include "actor/fragment_sender.h"

#include <utility>

#include <absl/strings/str_cat.h>

#include "actor/error_policy.h"
#include "common/base/backoff.h"
#include "common/base/clock.h"
#include "common/telemetry/log.h"
#include "common/wire/convert.h"
#include "common/wire/grpc_status.h"

namespace craftfleet {
namespace {

constexpr absl::Duration kFirstPause = absl::Milliseconds(250);  // before the next stream
constexpr absl::Duration kLastPause = absl::Seconds(2);
constexpr absl::Duration kLogAgain = absl::Seconds(10);  // between two lines about the same error

HeldPermit PermitOf(const v1::FragmentMessage& message) {
  return {{message.lane(), message.number(), message.policy_version()}, message.epoch()};
}

}  // namespace

FragmentSender::FragmentSender(const LearnerClient* learner, std::string actor, PermitTracker* permits)
    : learner_(learner), actor_(std::move(actor)), permits_(permits) {}

FragmentSender::~FragmentSender() { Stop(); }

void FragmentSender::Start() {
  thread_ = std::thread([this] { Run(); });
}

absl::Status FragmentSender::Push(Fragment fragment) {
  const MutexLock lock(&mu_);
  changed_.Wait(&mu_,
                [this]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) { return stopping_ || waiting_.size() < kQueueCapacity; });
  if (stopping_) return absl::CancelledError("stopping");
  waiting_.push_back(std::move(fragment));
  changed_.NotifyAll();
  return absl::OkStatus();
}

void FragmentSender::DropWaiting() {
  const MutexLock lock(&mu_);
  for (const Fragment& fragment : waiting_) {
    permits_->Release({{fragment.lane, fragment.number, fragment.policy_version}, fragment.epoch});
  }
  waiting_.clear();
  changed_.NotifyAll();
}

void FragmentSender::Stop() {
  {
    const MutexLock lock(&mu_);
    stopping_ = true;
    if (context_ != nullptr) context_->TryCancel();
    changed_.NotifyAll();
  }
  if (thread_.joinable()) thread_.join();
}

bool FragmentSender::stopping() const {
  const MutexLock lock(&mu_);
  return stopping_;
}

void FragmentSender::Run() {
  Backoff backoff(kFirstPause, kLastPause);
  while (true) {
    const int64_t verdicts = accepted_ + refused_;
    std::unique_ptr<Stream> stream;
    {
      const MutexLock lock(&mu_);
      if (stopping_) return;
      context_ = std::make_unique<grpc::ClientContext>();
      written_ = 0;
      ended_ = false;
      stream = learner_->PushFragments(context_.get());
    }
    absl::Status status = Serve(stream.get());
    const absl::Status end = wire::FromGrpc(stream->Finish(), learner_->name());
    if (status.ok()) status = end.ok() ? absl::UnavailableError(learner_->name() + ": ended the stream") : end;
    if (!stopping()) Explain(status);
    if (accepted_ + refused_ > verdicts) backoff.Reset();
    const MutexLock lock(&mu_);
    context_ = nullptr;
    changed_.WaitFor(&mu_, backoff.Next(), [this]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) { return stopping_; });
  }
}

absl::Status FragmentSender::Serve(Stream* stream) {
  absl::Status status;
  std::thread reader([&] { status = ReadVerdicts(stream); });
  for (Message message = NextToWrite(); message != nullptr && stream->Write(*message); message = NextToWrite()) {
  }
  reader.join();
  return status;
}

FragmentSender::Message FragmentSender::NextToWrite() {
  const MutexLock lock(&mu_);
  changed_.Wait(&mu_, [this]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) {
    return stopping_ || ended_ || written_ < under_way_.size() ||
           (!waiting_.empty() && under_way_.size() < kMaxUnderWay);
  });
  if (stopping_ || ended_) return nullptr;
  if (written_ < under_way_.size()) {
    ++resent_;
  } else {
    v1::FragmentMessage message = wire::ToProto(std::move(waiting_.front()));
    message.set_actor(actor_);
    under_way_.push_back(std::make_shared<const v1::FragmentMessage>(std::move(message)));
    waiting_.pop_front();
    changed_.NotifyAll();
  }
  return under_way_[written_++];
}

absl::Status FragmentSender::ReadVerdicts(Stream* stream) {
  absl::Status status;
  v1::FragmentVerdict verdict;
  while (status.ok() && stream->Read(&verdict)) status = TakeVerdict(verdict);
  const MutexLock lock(&mu_);
  ended_ = true;
  if (!status.ok()) context_->TryCancel();  // the stream is still open, and the writer may be blocked in it
  changed_.NotifyAll();
  return status;
}

absl::Status FragmentSender::TakeVerdict(const v1::FragmentVerdict& verdict) {
  const MutexLock lock(&mu_);
  if (written_ == 0 || verdict.lane() != under_way_.front()->lane() ||
      verdict.number() != under_way_.front()->number()) {
    return absl::InternalError(absl::StrCat(learner_->name(), ": verdict on fragment ", verdict.number(), " of lane ",
                                            verdict.lane(), ", want that of the oldest fragment sent"));
  }
  ++(verdict.verdict() == v1::FragmentVerdict::EXPIRED ? refused_ : accepted_);
  --written_;
  Settle();
  return absl::OkStatus();
}

void FragmentSender::Settle() {
  permits_->Release(PermitOf(*under_way_.front()));
  under_way_.pop_front();
  changed_.NotifyAll();
}

void FragmentSender::Explain(const absl::Status& why) {
  const MutexLock lock(&mu_);
  if (ReactionTo(CallKind::kPush, why) == Reaction::kDropFragment && !under_way_.empty()) {
    LogError("%s; the fragment is dropped: run programs of the same version", why.message());
    ++refused_;
    Settle();
  } else if (SteadyNow() - logged_ > kLogAgain) {
    logged_ = SteadyNow();
    LogWarning("%s; fragments will be sent again", why.message());
  }
}

}  // namespace craftfleet
