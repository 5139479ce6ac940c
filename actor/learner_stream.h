// The actor's stream to the learner: requests for permits, and fragments until each has a verdict.

#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <memory>
#include <optional>
#include <string>
#include <thread>

#include <absl/status/status.h>
#include <absl/status/statusor.h>

#include "actor/learner_client.h"
#include "actor/permit_tracker.h"
#include "common/base/mutex.h"
#include "common/base/types.h"

namespace craftfleet {

// One thread writes, another reads. A request overtakes the fragments that wait: on a slow link it waits for the one
// that is being written only. Several fragments are sent before the first verdict. A fragment is kept until the learner
// has answered: when the stream breaks, it is sent again on the next one, and the learner accepts it at most once. The
// verdict releases its permit. Thread-safe, but for Ask.
class LearnerStream {
 public:
  LearnerStream(const LearnerClient* learner, std::string actor, PermitTracker* permits);
  ~LearnerStream();

  void Start();
  // Requests permits; blocks until the reply. Called by one thread. Each stream begins with a request: after an error,
  // the next call opens another one, so its caller decides when.
  //   Cancelled: Cancel was called.   DeadlineExceeded: no reply in time.   Others: why the stream has ended, as
  //   learner.proto states.
  absl::StatusOr<v1::PermitReply> Ask(const v1::PermitRequest& request) ABSL_LOCKS_EXCLUDED(mu_);
  // Queues a fragment; blocks while `kQueueCapacity` fragments are waiting.   Cancelled: Cancel was called.
  absl::Status Push(Fragment fragment) ABSL_LOCKS_EXCLUDED(mu_);
  // Drops the fragments not yet sent, and releases their permits: the learner no longer expects them.
  void DropWaiting() ABSL_LOCKS_EXCLUDED(mu_);
  // Ends all current and future calls. Fragments without a verdict are lost; other actors play them. Idempotent.
  void Cancel() ABSL_LOCKS_EXCLUDED(mu_);
  // The same, and ends the threads. Idempotent; called by one thread.
  void Stop() ABSL_LOCKS_EXCLUDED(mu_);

  int64_t accepted() const { return accepted_.load(); }
  int64_t refused() const { return refused_.load(); }
  int64_t resent() const { return resent_.load(); }

 private:
  using Stream = grpc::ClientReaderWriter<v1::ActorMessage, v1::LearnerMessage>;
  using Message = std::shared_ptr<const v1::ActorMessage>;
  static constexpr size_t kQueueCapacity = 64;  // fragments waiting
  // Fragments sent without a verdict. With a round trip of 100 ms, 16 of 32 steps each allow about 60 MB/s.
  static constexpr size_t kMaxUnderWay = 16;

  void Run() ABSL_LOCKS_EXCLUDED(mu_);
  // Writes and reads until the stream ends. Returns why.
  absl::Status Serve(grpc::ClientContext* context) ABSL_LOCKS_EXCLUDED(mu_);
  // The next message for the current stream; waits for one. Null: the stream ended, or we are stopping.
  Message NextToWrite() ABSL_LOCKS_EXCLUDED(mu_);
  void Read(Stream* stream) ABSL_LOCKS_EXCLUDED(mu_);
  absl::Status Take(v1::LearnerMessage* message) ABSL_LOCKS_EXCLUDED(mu_);
  absl::Status TakeVerdict(const v1::FragmentVerdict& verdict) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // Ends the current stream because of `why`.
  void Break(const absl::Status& why) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);

  const LearnerClient* const learner_;
  const std::string actor_;
  PermitTracker* const permits_;

  std::atomic<int64_t> accepted_{0};
  std::atomic<int64_t> refused_{0};
  std::atomic<int64_t> resent_{0};

  mutable Mutex mu_;
  CondVar changed_;
  bool stopping_ ABSL_GUARDED_BY(mu_) = false;
  Message request_ ABSL_GUARDED_BY(mu_);                       // to be written; null: none
  std::optional<v1::PermitReply> reply_ ABSL_GUARDED_BY(mu_);  // for Ask
  absl::Status failure_ ABSL_GUARDED_BY(mu_);                  // why the last stream ended, until Ask returns it
  std::deque<Fragment> waiting_ ABSL_GUARDED_BY(mu_);
  std::deque<Message> under_way_ ABSL_GUARDED_BY(mu_);  // fragments without a verdict, oldest first
  // Of the current stream:
  std::unique_ptr<grpc::ClientContext> context_ ABSL_GUARDED_BY(mu_);  // null: there is none
  size_t written_ ABSL_GUARDED_BY(mu_) = 0;                            // how many of under_way_
  bool asked_ ABSL_GUARDED_BY(mu_) = false;                            // a request without a reply was written
  bool ended_ ABSL_GUARDED_BY(mu_) = false;
  absl::Status broken_ ABSL_GUARDED_BY(mu_);  // why this side ended it
  std::thread thread_;
};

}  // namespace craftfleet
