#include "learner/service/actor_stream.h"

#include <utility>

#include "common/base/status_macros.h"
#include "common/wire/grpc_status.h"

namespace craftfleet {
namespace {

constexpr size_t kMaxAnswers = 64;  // that wait to be taken by a client, before no more is read from it

}  // namespace

ActorStream::ActorStream(LearnerServiceImpl* service, grpc::CallbackServerContext* context)
    : service_(service),
      context_(context),
      number_(++service->last_stream_),
      watched_(std::in_place, &service->streams_, context) {}

void ActorStream::Start(std::shared_ptr<ActorStream> self) {
  self_ = std::move(self);
  const MutexLock lock(&mu_);
  if (!watched_->admitted().ok()) end_ = watched_->admitted();
  Proceed();
}

void ActorStream::OnReadDone(bool ok) {
  if (ok && !over()) {
    if (const absl::Status status = Answer(); !status.ok()) End(status);
  }
  message_ = v1::ActorMessage();  // a stream that waits must not keep megabytes of its last fragment
  const MutexLock lock(&mu_);
  reading_ = false;
  read_all_ = !ok;
  Proceed();
}

void ActorStream::OnWriteDone(bool ok) {
  const MutexLock lock(&mu_);
  writing_ = false;
  answers_.pop_front();
  if (!ok) {  // nobody takes them any more
    answers_.clear();
    end_ = absl::CancelledError("the client disconnected");
  }
  Proceed();
}

void ActorStream::OnCancel() {
  cancelled_ = true;
  End(absl::CancelledError("the client disconnected"));
  std::string actor;
  {
    const MutexLock lock(&mu_);
    actor = actor_;
  }
  service_->registry_->OnConnectionLost(actor, number_);
  service_->waiting_for_permits_.Retry(actor);  // which drops its request
}

absl::Status ActorStream::Answer() {
  CRAFTFLEET_RETURN_IF_ERROR(service_->CheckAllowed(*context_));
  if (message_.has_permits()) return Ask(message_.permits());
  if (!message_.has_fragment()) {
    return absl::InvalidArgumentError("a message without permits or fragment, or an unreadable one");
  }
  v1::LearnerMessage answer;
  CRAFTFLEET_ASSIGN_OR_RETURN(*answer.mutable_verdict(), service_->Receive(*context_, message_.mutable_fragment()));
  Send(std::move(answer));
  return absl::OkStatus();
}

absl::Status ActorStream::Ask(const v1::PermitRequest& request) {
  CRAFTFLEET_RETURN_IF_ERROR(service_->CheckPermits(*context_, request));
  {
    const MutexLock lock(&mu_);
    if (std::exchange(asked_, true)) {
      return absl::InvalidArgumentError("a request for permits before the reply to the last one");
    }
    actor_ = request.actor();
  }
  WorkerRegistry::PermitRequest asked = service_->ToRequest(service_->ClientOf(*context_), request);
  asked.stream = number_;
  asked.is_cancelled = [this] { return cancelled_.load(); };
  const absl::Duration wait = asked.wait;
  service_->waiting_for_permits_.Add(
      [self = self_, asked = std::move(asked), started = false](bool last) mutable {
        return self->TryToGrant(asked, !std::exchange(started, true), last);
      },
      wait, request.actor());
  return absl::OkStatus();
}

bool ActorStream::TryToGrant(const WorkerRegistry::PermitRequest& asked, bool first, bool last) {
  if (over()) return true;
  std::optional<absl::StatusOr<WorkerRegistry::PermitReply>> given;
  if (first) given = service_->registry_->StartPermits(asked);
  if (!given.has_value()) given = service_->registry_->RetryPermits(asked, last);
  if (!given.has_value()) return false;
  if (!given->ok()) {
    End(service_->LogRefusal(asked.client, given->status()));
    return true;
  }
  v1::LearnerMessage answer;
  service_->FillPermits(**given, answer.mutable_permits());
  Send(std::move(answer));
  return true;
}

bool ActorStream::over() const {
  const MutexLock lock(&mu_);
  return end_.has_value();
}

void ActorStream::Send(v1::LearnerMessage answer) {
  const MutexLock lock(&mu_);
  if (end_.has_value()) return;
  answers_.push_back(std::move(answer));
  Proceed();
}

void ActorStream::End(absl::Status status) {
  const MutexLock lock(&mu_);
  if (!end_.has_value()) end_ = std::move(status);
  Proceed();
}

void ActorStream::Proceed() {
  if (!watched_.has_value()) return;  // finished
  if (!writing_ && !answers_.empty()) {
    writing_ = true;
    if (answers_.front().has_permits()) asked_ = false;
    watched_->Await("an answer to be taken", service_->options_.reply_timeout);
    StartWrite(&answers_.front());
  }
  if (!writing_ && (end_.has_value() || (read_all_ && !asked_))) return FinishCall();
  if (!writing_ && asked_) watched_->Work();
  if (!writing_ && !asked_) watched_->Await("a message", service_->options_.message_timeout);
  if (!reading_ && !read_all_ && !end_.has_value() && answers_.size() <= kMaxAnswers) {
    reading_ = true;
    StartRead(&message_);
  }
}

void ActorStream::FinishCall() {
  absl::Status status = watched_->late();
  if (status.ok()) status = end_.value_or(absl::OkStatus());
  watched_.reset();
  Finish(wire::ToGrpc(status));
}

}  // namespace craftfleet
