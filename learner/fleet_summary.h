// Summarises the whole fleet for the learner's status page.

#ifndef CRAFTFLEET_LEARNER_FLEET_SUMMARY_H_
#define CRAFTFLEET_LEARNER_FLEET_SUMMARY_H_

#include "common/telemetry/activity_meter.h"
#include "craftfleet/v1/status.pb.h"
#include "learner/bottleneck.h"

namespace craftfleet {

// Makes the input of FindBottleneck from `reply.peers` and the training thread's recent work, `trainer`.
FleetView ViewFleet(const Work& trainer, const v1::StatusReply& reply);

// FleetTimes and FindBottleneck of `view`, with the run's state.
v1::FleetSummary SummarizeFleet(const FleetView& view);

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_FLEET_SUMMARY_H_
