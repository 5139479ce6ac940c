// Holds the newest weights, for the gRPC service and for actors in this process.

#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <memory>
#include <utility>

#include "common/agent/policy_weights.h"
#include "common/base/mutex.h"
#include "learner/ppo/value_norm.h"

namespace craftfleet {

// Keeps the last `kept` versions. Thread-safe.
class WeightStore {
 public:
  struct Weights {
    int64_t version = -1;                          // -1: none published yet
    std::shared_ptr<const PolicyWeights> weights;  // null: none
    ValueRange values;                             // of fragments played with them
    ValueScale value_scale;                        // of the values that they predict
  };

  // `kept`: 1 or more.
  explicit WeightStore(size_t kept = 1) : kept_(kept) {}

  // `version` must grow from call to call.
  void Publish(int64_t version, std::shared_ptr<const PolicyWeights> weights, const ValueRange& values = {},
               const ValueScale& value_scale = {}) ABSL_LOCKS_EXCLUDED(mu_) {
    const MutexLock lock(&mu_);
    if (newest_.size() == kept_) newest_.pop_front();
    newest_.push_back({version, std::move(weights), values, value_scale});
  }

  // The weights of `version` if they are kept, otherwise the latest, which may be older.
  Weights Find(int64_t version) const ABSL_LOCKS_EXCLUDED(mu_) {
    const MutexLock lock(&mu_);
    for (const Weights& weights : newest_) {
      if (weights.version == version) return weights;
    }
    return newest_.empty() ? Weights() : newest_.back();
  }

  // At least one version was published.
  Weights Oldest() const ABSL_LOCKS_EXCLUDED(mu_) {
    const MutexLock lock(&mu_);
    return newest_.front();
  }

 private:
  const size_t kept_;
  mutable Mutex mu_;
  std::deque<Weights> newest_ ABSL_GUARDED_BY(mu_);  // the latest last
};

}  // namespace craftfleet
