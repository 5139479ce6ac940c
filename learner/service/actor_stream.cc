// LearnerServiceImpl: actors' streams of requests and fragments.
#include <atomic>
#include <cstdint>
#include <deque>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "common/base/mutex.h"
#include "common/base/status_macros.h"
#include "common/wire/grpc_status.h"
#include "learner/service/learner_service.h"

namespace craftfleet {
namespace {

constexpr size_t kMaxAnswers = 64;  // that wait to be taken by a client, before no more is read from it

}  // namespace

// One call of Play. Reads one message and writes one at a time; answers that have to wait are queued. gRPC's threads
// and the one of WaitingCalls use it at once. Its lock is held while it starts reads and writes, which calls nothing
// back, and never while it calls the service or the registry. A request that waits shares it.
class LearnerServiceImpl::ActorStream final : public grpc::ServerBidiReactor<v1::ActorMessage, v1::LearnerMessage> {
 public:
  ActorStream(LearnerServiceImpl* service, grpc::CallbackServerContext* context)
      : service_(service),
        context_(context),
        number_(++service->last_stream_),
        watched_(std::in_place, &service->streams_, context) {}

  void Start(std::shared_ptr<ActorStream> self) {
    self_ = std::move(self);
    const MutexLock lock(&mu_);
    if (!watched_->admitted().ok()) end_ = watched_->admitted();
    Proceed();
  }

  void OnReadDone(bool ok) override {
    if (ok && !over()) {
      if (const absl::Status status = Answer(); !status.ok()) End(status);
    }
    message_ = v1::ActorMessage();  // a stream that waits must not keep megabytes of its last fragment
    const MutexLock lock(&mu_);
    reading_ = false;
    read_all_ = !ok;
    Proceed();
  }

  void OnWriteDone(bool ok) override {
    const MutexLock lock(&mu_);
    writing_ = false;
    answers_.pop_front();
    if (!ok) {  // nobody takes them any more
      answers_.clear();
      end_ = absl::CancelledError("the client disconnected");
    }
    Proceed();
  }

  void OnCancel() override {
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

  void OnDone() override { self_.reset(); }

 private:
  // Answers the message that was read, now or later.   Errors end the stream.
  absl::Status Answer() {
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

  absl::Status Ask(const v1::PermitRequest& request) ABSL_LOCKS_EXCLUDED(mu_) {
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

  // As WaitingCalls::Attempt. The call may be over by now, and its context gone.
  bool TryToGrant(const WorkerRegistry::PermitRequest& asked, bool first, bool last) ABSL_LOCKS_EXCLUDED(mu_) {
    if (over()) return true;
    const auto given = service_->registry_->TryPermits(asked, first, last);
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

  bool over() const ABSL_LOCKS_EXCLUDED(mu_) {
    const MutexLock lock(&mu_);
    return end_.has_value();
  }

  void Send(v1::LearnerMessage answer) ABSL_LOCKS_EXCLUDED(mu_) {
    const MutexLock lock(&mu_);
    if (end_.has_value()) return;
    answers_.push_back(std::move(answer));
    Proceed();
  }

  // Ends the call once all answers are written.
  void End(absl::Status status) ABSL_LOCKS_EXCLUDED(mu_) {
    const MutexLock lock(&mu_);
    if (!end_.has_value()) end_ = std::move(status);
    Proceed();
  }

  // Starts what can be started.
  void Proceed() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) {
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

  // Frees the stream's place before the client learns that it has ended.
  void FinishCall() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) {
    absl::Status status = watched_->late();
    if (status.ok()) status = end_.value_or(absl::OkStatus());
    watched_.reset();
    Finish(wire::ToGrpc(status));
  }

  LearnerServiceImpl* const service_;
  grpc::CallbackServerContext* const context_;
  const int64_t number_;
  std::shared_ptr<ActorStream> self_;  // until OnDone
  v1::ActorMessage message_;           // used by the read under way, or by its callback
  std::atomic<bool> cancelled_{false};

  mutable Mutex mu_;
  std::optional<wire::StreamWatch::Stream> watched_ ABSL_GUARDED_BY(mu_);  // until the call is finished
  std::deque<v1::LearnerMessage> answers_ ABSL_GUARDED_BY(mu_);            // the first is being written if `writing_`
  bool reading_ ABSL_GUARDED_BY(mu_) = false;
  bool writing_ ABSL_GUARDED_BY(mu_) = false;
  bool read_all_ ABSL_GUARDED_BY(mu_) = false;            // the client sends no more
  bool asked_ ABSL_GUARDED_BY(mu_) = false;               // a request for permits has no reply that was sent yet
  std::string actor_ ABSL_GUARDED_BY(mu_);                // of the last request for permits
  std::optional<absl::Status> end_ ABSL_GUARDED_BY(mu_);  // the call ends with it
};

grpc::ServerBidiReactor<v1::ActorMessage, v1::LearnerMessage>* LearnerServiceImpl::Play(
    grpc::CallbackServerContext* context) {
  const auto stream = std::make_shared<ActorStream>(this, context);
  stream->Start(stream);
  return stream.get();
}

}  // namespace craftfleet
