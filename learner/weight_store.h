// Holds the current weights as bytes, for the gRPC service.

#ifndef CRAFTFLEET_LEARNER_WEIGHT_STORE_H_
#define CRAFTFLEET_LEARNER_WEIGHT_STORE_H_

#include <cstdint>
#include <memory>
#include <string>
#include <utility>

#include <absl/time/time.h>

#include "common/base/mutex.h"

namespace craftfleet {

// Keeps only the latest version. Thread-safe.
class WeightStore {
 public:
  struct Weights {
    int64_t version = -1;                      // -1: none published yet
    std::shared_ptr<const std::string> bytes;  // safetensors
  };

  // Publishes `bytes` (safetensors) and wakes waiting calls. `version` must grow from call to call.
  void Publish(int64_t version, std::shared_ptr<const std::string> bytes) ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    weights_ = {version, std::move(bytes)};
    changed_.NotifyAll();
  }

  // Waits up to `timeout` for `version` or a later one. Returns the latest weights, which may still be older.
  Weights Wait(int64_t version, absl::Duration timeout) ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    changed_.WaitFor(&mu_, timeout, [&]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) { return weights_.version >= version; });
    return weights_;
  }

 private:
  Mutex mu_;
  CondVar changed_;
  Weights weights_ ABSL_GUARDED_BY(mu_);
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_WEIGHT_STORE_H_
