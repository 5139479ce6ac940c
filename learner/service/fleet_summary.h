// Summarises the whole fleet for the learner's status page.

#ifndef CRAFTFLEET_LEARNER_SERVICE_FLEET_SUMMARY_H_
#define CRAFTFLEET_LEARNER_SERVICE_FLEET_SUMMARY_H_

#include <vector>

#include "common/telemetry/activity_meter.h"
#include "craftfleet/v1/status.pb.h"
#include "learner/scheduling/worker_registry.h"
#include "learner/service/bottleneck.h"

namespace craftfleet {

// Makes the input of FindBottleneck from the workers and the training thread's recent work, `trainer`.
FleetView ViewFleet(const Work& trainer, const std::vector<WorkerRegistry::WorkerInfo>& workers);

// Adds the numbers of workers by role and health.
void CountWorkers(const std::vector<WorkerRegistry::WorkerInfo>& workers, v1::FleetSummary* summary);

// FleetTimes and FindBottleneck of `view`, with the run's state.
v1::FleetSummary SummarizeFleet(const FleetView& view);

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_SERVICE_FLEET_SUMMARY_H_
