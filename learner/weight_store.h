// Holds the newest weights as bytes, for the gRPC service.

#ifndef CRAFTFLEET_LEARNER_WEIGHT_STORE_H_
#define CRAFTFLEET_LEARNER_WEIGHT_STORE_H_

#include <cstddef>
#include <cstdint>
#include <deque>
#include <memory>
#include <string>
#include <utility>

#include <absl/time/time.h>

#include "common/base/mutex.h"

namespace craftfleet {

// Keeps the last `kept` versions. Thread-safe.
class WeightStore {
 public:
  struct Weights {
    int64_t version = -1;                      // -1: none published yet
    std::shared_ptr<const std::string> bytes;  // safetensors
  };

  // `kept`: 1 or more.
  explicit WeightStore(size_t kept = 1) : kept_(kept) {}

  // Publishes `bytes` (safetensors) and wakes waiting calls. `version` must grow from call to call.
  void Publish(int64_t version, std::shared_ptr<const std::string> bytes) ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    if (newest_.size() == kept_) newest_.pop_front();
    newest_.push_back({version, std::move(bytes)});
    changed_.NotifyAll();
  }

  // Waits up to `timeout` for `version` or a later one. Returns the weights of `version` if they are kept, otherwise
  // the latest, which may still be older.
  Weights Wait(int64_t version, absl::Duration timeout) ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    changed_.WaitFor(&mu_, timeout, [&]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) {
      return !newest_.empty() && newest_.back().version >= version;
    });
    for (const Weights& weights : newest_) {
      if (weights.version == version) return weights;
    }
    return newest_.empty() ? Weights() : newest_.back();
  }

 private:
  const size_t kept_;
  Mutex mu_;
  CondVar changed_;
  std::deque<Weights> newest_ ABSL_GUARDED_BY(mu_);  // the latest last
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_WEIGHT_STORE_H_
