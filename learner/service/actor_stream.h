// An actor's stream of requests and fragments.

#pragma once

#include <atomic>
#include <cstdint>
#include <deque>
#include <memory>
#include <optional>
#include <string>

#include <absl/base/thread_annotations.h>
#include <absl/status/status.h>
#include <grpcpp/grpcpp.h>

#include "common/base/mutex.h"
#include "common/wire/stream_watch.h"
#include "craftfleet/v1/learner.pb.h"
#include "learner/scheduling/worker_registry.h"
#include "learner/service/learner_service.h"

namespace craftfleet {

// One call of Play. Reads one message and writes one at a time; answers that have to wait are queued. gRPC's threads
// and the one of WaitingCalls use it at once. Its lock is held while it starts reads and writes, which calls nothing
// back, and never while it calls the service or the registry. A request that waits shares it.
class ActorStream final : public grpc::ServerBidiReactor<v1::ActorMessage, v1::LearnerMessage> {
 public:
  ActorStream(LearnerServiceImpl* service, grpc::CallbackServerContext* context);

  void Start(std::shared_ptr<ActorStream> self);

  void OnReadDone(bool ok) override;
  void OnWriteDone(bool ok) override;
  void OnCancel() override;
  void OnDone() override { self_.reset(); }

 private:
  // Answers the message that was read, now or later.   Errors end the stream.
  absl::Status Answer();
  absl::Status Ask(const v1::PermitRequest& request) ABSL_LOCKS_EXCLUDED(mu_);
  // As WaitingCalls::Attempt. The call may be over by now, and its context gone.
  bool TryToGrant(const WorkerRegistry::PermitRequest& asked, bool first, bool last) ABSL_LOCKS_EXCLUDED(mu_);
  bool over() const ABSL_LOCKS_EXCLUDED(mu_);
  void Send(v1::LearnerMessage answer) ABSL_LOCKS_EXCLUDED(mu_);
  // Ends the call once all answers are written.
  void End(absl::Status status) ABSL_LOCKS_EXCLUDED(mu_);
  // Starts what can be started.
  void Proceed() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // Frees the stream's place before the client learns that it has ended.
  void FinishCall() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);

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

}  // namespace craftfleet
