// Sends finished fragments to the learner, until each has its verdict.

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
#include "actor/permit_book.h"
#include "common/mutex.h"
#include "common/types.h"

namespace craftfleet {

// One stream at a time: a thread writes fragments, several before the first one's verdict, another reads verdicts. A
// fragment is kept until the learner answered for it: when the stream breaks it is sent again on the next one, and the
// learner accepts it at most once. Its permit is released with the verdict. Thread-safe.
class FragmentSender {
 public:
  FragmentSender(const LearnerClient* learner, std::string actor, PermitBook* permits);
  ~FragmentSender();

  void Start();
  // Takes a fragment; blocks while `kQueueCapacity` of them wait.   Cancelled: stopping.
  absl::Status Push(Fragment fragment) ABSL_LOCKS_EXCLUDED(mu_);
  // Forgets what is not on its way yet, and its permits: the learner does not know of them any more.
  void DropWaiting() ABSL_LOCKS_EXCLUDED(mu_);
  // Sends nothing more; fragments without a verdict are lost (another actor will play them). Idempotent.
  void Stop() ABSL_LOCKS_EXCLUDED(mu_);

  int64_t accepted() const { return accepted_.load(); }
  int64_t refused() const { return refused_.load(); }
  int64_t resent() const { return resent_.load(); }

 private:
  using Stream = grpc::ClientReaderWriter<v1::FragmentMessage, v1::FragmentVerdict>;
  using Message = std::shared_ptr<const v1::FragmentMessage>;
  static constexpr size_t kQueueCapacity = 64;  // fragments waiting
  // Fragments without a verdict. Over a round trip of 100 ms, 16 of 32 steps are some 60 MB a second.
  static constexpr size_t kMaxUnderWay = 16;

  void Run() ABSL_LOCKS_EXCLUDED(mu_);
  // Writes and reads until the stream ends; says why, if not by itself.
  absl::Status Serve(Stream* stream) ABSL_LOCKS_EXCLUDED(mu_);
  // The next fragment for the stream at hand; waits for one. Null: the stream ended, or we are stopping.
  Message NextToWrite() ABSL_LOCKS_EXCLUDED(mu_);
  absl::Status ReadVerdicts(Stream* stream) ABSL_LOCKS_EXCLUDED(mu_);
  absl::Status TakeVerdict(const v1::FragmentVerdict& verdict) ABSL_LOCKS_EXCLUDED(mu_);
  // Logs why the stream ended; drops the fragment that the learner calls wrong.
  void Explain(const absl::Status& why) ABSL_LOCKS_EXCLUDED(mu_);
  // The oldest fragment under way needs nothing more.
  void Settle() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  bool stopping() const ABSL_LOCKS_EXCLUDED(mu_);

  const LearnerClient* const learner_;
  const std::string actor_;
  PermitBook* const permits_;
  absl::Time said_ = absl::InfinitePast();  // that fragments wait; the writing thread's own

  std::atomic<int64_t> accepted_{0};
  std::atomic<int64_t> refused_{0};
  std::atomic<int64_t> resent_{0};

  mutable Mutex mu_;
  CondVar changed_;
  bool stopping_ ABSL_GUARDED_BY(mu_) = false;
  std::deque<Fragment> waiting_ ABSL_GUARDED_BY(mu_);
  std::deque<Message> under_way_ ABSL_GUARDED_BY(mu_);  // without a verdict, oldest first
  size_t written_ ABSL_GUARDED_BY(mu_) = 0;             // how many of those, on the stream at hand
  bool ended_ ABSL_GUARDED_BY(mu_) = false;             // the stream at hand
  std::unique_ptr<grpc::ClientContext> context_ ABSL_GUARDED_BY(mu_);
  std::thread thread_;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_ACTOR_FRAGMENT_SENDER_H_
