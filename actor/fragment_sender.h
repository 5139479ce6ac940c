// Sends finished fragments to the learner until each has a verdict.

#ifndef CRAFTFLEET_ACTOR_FRAGMENT_SENDER_H_
#define CRAFTFLEET_ACTOR_FRAGMENT_SENDER_H_

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <memory>
#include <string>
#include <thread>

#include "actor/learner_client.h"
#include "actor/permit_tracker.h"
#include "common/base/mutex.h"
#include "common/base/types.h"

namespace craftfleet {

// Uses one stream at a time. One thread writes fragments, several of them before the first verdict; another reads
// verdicts. A fragment is kept until the learner has answered: when the stream breaks, it is sent again on the next
// one, and the learner accepts it at most once. The verdict releases its permit. Thread-safe.
class FragmentSender {
 public:
  FragmentSender(const LearnerClient* learner, std::string actor, PermitTracker* permits);
  ~FragmentSender();

  void Start();
  // Queues a fragment; blocks while `kQueueCapacity` fragments are waiting.   Cancelled: Stop was called.
  absl::Status Push(Fragment fragment) ABSL_LOCKS_EXCLUDED(mu_);
  // Drops the fragments not yet sent, and releases their permits: the learner no longer expects them.
  void DropWaiting() ABSL_LOCKS_EXCLUDED(mu_);
  // Stops sending. Fragments without a verdict are lost; other actors play them. Idempotent.
  void Stop() ABSL_LOCKS_EXCLUDED(mu_);

  int64_t accepted() const { return accepted_.load(); }
  int64_t refused() const { return refused_.load(); }
  int64_t resent() const { return resent_.load(); }

 private:
  using Stream = grpc::ClientReaderWriter<v1::FragmentMessage, v1::FragmentVerdict>;
  using Message = std::shared_ptr<const v1::FragmentMessage>;
  static constexpr size_t kQueueCapacity = 64;  // fragments waiting
  // Fragments sent without a verdict. With a round trip of 100 ms, 16 of 32 steps each allow about 60 MB/s.
  static constexpr size_t kMaxUnderWay = 16;

  void Run() ABSL_LOCKS_EXCLUDED(mu_);
  // Writes fragments and reads verdicts until the stream ends. Returns an error if this side ended it.
  absl::Status Serve(Stream* stream) ABSL_LOCKS_EXCLUDED(mu_);
  // The next fragment for the current stream; waits for one. Null: the stream ended, or we are stopping.
  Message NextToWrite() ABSL_LOCKS_EXCLUDED(mu_);
  absl::Status ReadVerdicts(Stream* stream) ABSL_LOCKS_EXCLUDED(mu_);
  absl::Status TakeVerdict(const v1::FragmentVerdict& verdict) ABSL_LOCKS_EXCLUDED(mu_);
  // Logs why the stream ended. Drops the oldest fragment if the learner refused it for good.
  void Explain(const absl::Status& why) ABSL_LOCKS_EXCLUDED(mu_);
  // Removes the oldest fragment under way and releases its permit.
  void Settle() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  bool stopping() const ABSL_LOCKS_EXCLUDED(mu_);

  const LearnerClient* const learner_;
  const std::string actor_;
  PermitTracker* const permits_;
  absl::Time logged_ = absl::InfinitePast();  // when waiting fragments were last logged; used by the writing thread

  std::atomic<int64_t> accepted_{0};
  std::atomic<int64_t> refused_{0};
  std::atomic<int64_t> resent_{0};

  mutable Mutex mu_;
  CondVar changed_;
  bool stopping_ ABSL_GUARDED_BY(mu_) = false;
  std::deque<Fragment> waiting_ ABSL_GUARDED_BY(mu_);
  std::deque<Message> under_way_ ABSL_GUARDED_BY(mu_);  // without a verdict, oldest first
  size_t written_ ABSL_GUARDED_BY(mu_) = 0;             // how many of those, on the current stream
  bool ended_ ABSL_GUARDED_BY(mu_) = false;             // the current stream
  std::unique_ptr<grpc::ClientContext> context_ ABSL_GUARDED_BY(mu_);
  std::thread thread_;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_ACTOR_FRAGMENT_SENDER_H_
