// A registry whose workers all have the same identity and build, with short forms of its calls.

#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>
#include <absl/time/clock.h>
#include <absl/time/time.h>

#include "common/base/clock.h"
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

  using WorkerRegistry::Join;
  using WorkerRegistry::Leave;
  void Join(absl::string_view actor, absl::string_view address) {
    WorkerRegistry::Join({}, actor, address, {}).IgnoreError();
  }
  void Leave(absl::string_view actor) { WorkerRegistry::Leave({}, WorkerRole::kActor, actor).IgnoreError(); }
  // Waits up to `request.wait` while there is nothing to grant.
  absl::StatusOr<Grant> GetPermits(const PermitRequest& request) {
    std::optional<absl::StatusOr<Grant>> grant = TryPermits(request, /*first=*/true, /*last=*/false);
    const absl::Time deadline = SteadyNow() + request.wait;
    while (!grant.has_value()) {
      const bool is_last = SteadyNow() >= deadline;
      grant = TryPermits(request, /*first=*/false, is_last);
      if (!grant.has_value()) absl::SleepFor(absl::Milliseconds(1));
    }
    return *std::move(grant);
  }
  absl::StatusOr<Grant> GetPermits(absl::string_view actor, std::vector<Permit> active, int capacity,
                                   absl::Duration wait) {
    PermitRequest request = RequestOf(actor, std::move(active), capacity);
    request.wait = wait;
    return GetPermits(request);
  }
  void Drain(absl::string_view worker) { SetDraining(worker, true).status().IgnoreError(); }
  absl::StatusOr<WorkerId> Undrain(absl::string_view worker) { return SetDraining(worker, false); }
  bool IsDrained(const std::string& actor) { return WorkerRegistry::IsDrained({WorkerRole::kActor, actor}); }

  // Those of the parts.
  std::vector<LaneRecord> Records() const { return lanes()->table().Records(); }
  std::vector<LaneRecord> StartRecords() const { return lanes()->table().Records(&LaneState::start); }
  std::vector<LaneActor> Actors() const {
    const LaneTable::ActorMap all = lanes()->table().actors();
    std::vector<LaneActor> actors;
    for (const auto& [name, actor] : all) actors.push_back(actor);
    return actors;
  }
  // Those that are there, by name.
  std::vector<Worker> Servers() const {
    std::vector<Worker> servers;
    for (const WorkerInfo& info : Workers()) {
      if (info.worker.role == WorkerRole::kEnvServer && info.worker.active) servers.push_back(info.worker);
    }
    return servers;
  }
  absl::StatusOr<LaneSnapshot> Snapshot(int lane, int64_t fragment) const {
    return lanes()->table().Snapshot(lane, fragment);
  }
  bool Counts(int lane, int64_t fragment, uint64_t digest) const {
    return lanes()->table().Counts(lane, fragment, digest);
  }
  // Outstanding ones, of all actors.
  int permits() const {
    size_t permits = 0;
    for (const LaneActor& actor : Actors()) permits += actor.permits.size();
    return static_cast<int>(permits);
  }
  LaneCounters counters() const { return lanes()->table().counters; }
  void OpenIteration(int64_t last_fragment, int64_t policy_version) {
    lanes()->rollouts().OpenIteration(last_fragment, policy_version);
  }
  void PublishVersion(int64_t policy_version) { lanes()->rollouts().PublishVersion(policy_version); }
  std::optional<std::vector<Arrival>> TakeRollout() { return lanes()->rollouts().TakeRollout(); }
  void RewindIterations(int iterations) { lanes()->rollouts().RewindIterations(iterations); }
  bool SetPaused(bool paused) { return lanes()->assignment().SetPaused(paused); }
  bool paused() const { return lanes()->assignment().paused(); }
  void AddEvaluation(Evaluation evaluation) { evaluations()->Add(std::move(evaluation)); }
  void PopEvaluation() { evaluations()->Pop(); }
  size_t pending_evaluations() { return evaluations()->pending(); }

  static PermitRequest RequestOf(absl::string_view actor, std::vector<Permit> active, int capacity) {
    PermitRequest request;
    request.actor = std::string(actor);
    request.active = std::move(active);
    request.capacity = capacity;
    return request;
  }
};

}  // namespace craftfleet
