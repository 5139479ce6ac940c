// A registry whose workers all have the same identity and build, with short forms of its calls.

#ifndef CRAFTFLEET_TESTS_LEARNER_SCHEDULING_TEST_REGISTRY_H_
#define CRAFTFLEET_TESTS_LEARNER_SCHEDULING_TEST_REGISTRY_H_

#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>
#include <absl/time/time.h>

#include "learner/scheduling/worker_registry.h"

namespace craftfleet {

class TestRegistry : public WorkerRegistry {
 public:
  using Grant = PermitReply;

  TestRegistry(const LaneScheduler::Options& lanes, std::vector<LaneRecord> records, Clock* clock)
      : WorkerRegistry({lanes}, std::move(records), clock) {}
  // Has new lanes.
  TestRegistry(const Options& options, Clock* clock)
      : WorkerRegistry(options, std::vector<LaneRecord>(options.lanes.lanes), clock) {}

  void Join(absl::string_view actor, absl::string_view address) {
    WorkerRegistry::Join({}, actor, address, {}).IgnoreError();
  }
  void Leave(absl::string_view actor) { WorkerRegistry::Leave({}, WorkerRole::kActor, actor).IgnoreError(); }
  absl::StatusOr<Grant> GetPermits(absl::string_view actor, std::vector<Permit> active, int capacity,
                                   absl::Duration wait) {
    PermitRequest request = RequestOf(actor, std::move(active), capacity);
    request.wait = wait;
    return WorkerRegistry::GetPermits(request);
  }
  void Drain(absl::string_view worker) { WorkerRegistry::Drain(worker).status().IgnoreError(); }
  bool IsDrained(const std::string& actor) { return WorkerRegistry::IsDrained({WorkerRole::kActor, actor}); }

  static PermitRequest RequestOf(absl::string_view actor, std::vector<Permit> active, int capacity) {
    PermitRequest request;
    request.actor = std::string(actor);
    request.active = std::move(active);
    request.capacity = capacity;
    return request;
  }
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_TESTS_LEARNER_SCHEDULING_TEST_REGISTRY_H_
