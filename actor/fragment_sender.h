// Sends finished fragments to the learner, until each has its verdict.

#ifndef CRAFTFLEET_ACTOR_FRAGMENT_SENDER_H_
#define CRAFTFLEET_ACTOR_FRAGMENT_SENDER_H_

#include <atomic>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <thread>

#include "actor/learner_client.h"
#include "actor/permit_book.h"
#include "common/closable_queue.h"
#include "common/mutex.h"
#include "common/types.h"

namespace craftfleet {

// One thread, one stream. A fragment is kept until the learner answered for it: when the stream breaks it is sent again
// on the next one, and the learner accepts it at most once. Its permit is released with the verdict. Thread-safe.
class FragmentSender {
 public:
  FragmentSender(const LearnerClient* learner, std::string actor, PermitBook* permits);
  ~FragmentSender();

  void Start();
  // Takes a fragment; blocks while `kQueueCapacity` of them wait.   Cancelled: stopping.
  absl::Status Push(Fragment fragment) { return queue_.Push(std::move(fragment)); }
  // Sends nothing more; fragments without a verdict are lost (another actor will play them). Idempotent.
  void Stop() ABSL_LOCKS_EXCLUDED(mu_);

  int64_t accepted() const { return accepted_.load(); }
  int64_t refused() const { return refused_.load(); }
  int64_t resent() const { return resent_.load(); }

 private:
  using Stream = grpc::ClientReaderWriter<v1::FragmentMessage, v1::FragmentVerdict>;
  static constexpr size_t kQueueCapacity = 64;  // fragments waiting

  void Run();
  // Sends and reads verdicts until the stream breaks or Stop.
  absl::Status Serve(Stream* stream);
  // Sends `unanswered_` and waits for its verdict: with more than one under way both ends could wait in Write for the
  // other.
  absl::Status SendAndHear(Stream* stream);
  // Logs why the stream ended; drops the fragment that the learner calls wrong.
  void Explain(const absl::Status& why);
  // Ends the stream at hand, and the pause before the next one if stopping.
  void Cancel() ABSL_LOCKS_EXCLUDED(mu_);
  bool stopping() const { return queue_.closed(); }

  const LearnerClient* const learner_;
  const std::string actor_;
  PermitBook* const permits_;
  ClosableQueue<Fragment> queue_{kQueueCapacity};
  std::optional<v1::FragmentMessage> unanswered_;  // sent, without a verdict; the thread's own, like the next
  absl::Time said_ = absl::InfinitePast();         // that fragments wait

  std::atomic<int64_t> accepted_{0};
  std::atomic<int64_t> refused_{0};
  std::atomic<int64_t> resent_{0};

  Mutex mu_;
  CondVar stopped_;
  std::unique_ptr<grpc::ClientContext> context_ ABSL_GUARDED_BY(mu_);
  std::thread thread_;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_ACTOR_FRAGMENT_SENDER_H_
