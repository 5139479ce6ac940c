// What becomes of a fragment that an actor sends.

#pragma once

#include <atomic>
#include <cstdint>

#include <absl/status/statusor.h>

#include "common/base/types.h"
#include "common/wire/convert.h"
#include "craftfleet/v1/learner.pb.h"
#include "craftfleet/v1/status.pb.h"
#include "learner/scheduling/worker_registry.h"
#include "learner/training/fragments/fragment_collector.h"
#include "learner/training/fragments/fragment_frames.h"
#include "learner/training/weight_store.h"

namespace craftfleet {

// A digest of a fragment's content, which must be equal for two actors that play the same fragment: covers everything
// but the epoch and the fields that the learner sets. Compare digests within one process only. Thread-safe.
uint64_t FragmentDigest(const Fragment& fragment);

// Asks the registry whether a fragment is wanted, checks and converts it, and passes it to the trainer. Thread-safe.
class FragmentIntake {
 public:
  struct Parts {
    const FragmentFrames* frames;  // all pointers outlive it
    WorkerRegistry* registry;
    WeightStore* weights;
    FragmentQueue* fragments;
  };

  // `epoch`: number of the learner's start.
  FragmentIntake(int64_t epoch, const wire::FragmentShape& shape, const Parts& parts)
      : epoch_(epoch), shape_(shape), parts_(parts) {}

  // The verdict on a fragment of `client`: REFUSED, with the reason, if a field is out of its range.   InvalidArgument:
  // not a valid name.   Errors also as UseName.   Cancelled: the learner is stopping.
  absl::StatusOr<v1::FragmentVerdict> Receive(const WorkerClient& client, v1::FragmentMessage* message);

  // Adds the numbers of verdicts and of the fragments that wait for the trainer.
  void AddMetrics(v1::StatusReply* reply) const;

 private:
  // Whether it is wanted.   Errors as WorkerRegistry::Judge.   InvalidArgument: also, no such lane.
  absl::StatusOr<LaneScheduler::Verdict> Judge(const WorkerClient& client, const v1::FragmentMessage& message) const;
  // As Receive, for a valid name.   InvalidArgument: a field is out of its range.
  absl::StatusOr<v1::FragmentVerdict::Verdict> Take(const WorkerClient& client, v1::FragmentMessage* message);

  const int64_t epoch_;
  const wire::FragmentShape shape_;
  const Parts parts_;
  std::atomic<int64_t> accepted_{0};
  std::atomic<int64_t> duplicates_{0};
  std::atomic<int64_t> expired_{0};
  std::atomic<int64_t> rejected_{0};
};

}  // namespace craftfleet
