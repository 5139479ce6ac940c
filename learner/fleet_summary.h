// What the learner says of its fleet as a whole.

#ifndef CRAFTFLEET_LEARNER_FLEET_SUMMARY_H_
#define CRAFTFLEET_LEARNER_FLEET_SUMMARY_H_

#include "common/activity_meter.h"
#include "common/bottleneck.h"
#include "craftfleet/v1/status.pb.h"

namespace craftfleet {

// `reply.peers` as the bottleneck is judged by; `trainer` is the training thread's recent work.
FleetView ViewFleet(const Work& trainer, const v1::StatusReply& reply);

// FleetTimes and FindBottleneck of `view`.
v1::FleetSummary SummarizeFleet(const FleetView& view);

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_FLEET_SUMMARY_H_
