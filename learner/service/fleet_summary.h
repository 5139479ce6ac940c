// Summarises the whole fleet for the learner's status page, and finds what limits its speed.

#pragma once

#include <string>
#include <vector>

#include "common/telemetry/activity_meter.h"
#include "craftfleet/v1/status.pb.h"
#include "learner/scheduling/worker_registry.h"

namespace craftfleet {

// The learner's view of its fleet at one moment.
struct FleetView {
  bool finished = false;                           // the run is complete
  bool evaluating = false;                         // training is over, its final evaluation is not
  bool paused = false;                             // by craftfleet admin pause
  bool plays_on = false;                           // actors play during updates (overlap, max_staleness)
  int actors = 0;                                  // answering
  int env_servers = 0;                             // answering; also 0 if the actors are too old to report theirs
  int lost_env_servers = 0;                        // no longer answering
  std::vector<std::string> slow_env_servers = {};  // of `env_servers`, those that are slow: address and step time
  int drained_actors = 0;                          // of `actors`, those that get no work (craftfleet admin drain)
  int drained_env_servers = 0;                     // of `env_servers`, likewise
  double steps_per_second = 0;                     // of all actors
  ByActivity learner;       // seconds of its training thread, over the last seconds or iterations
  ByActivity actors_times;  // seconds of all actors' playing threads over the same time
  bool early = false;       // no update has been timed yet: the first iteration is being played
};

struct Bottleneck {
  std::string part;    // one of kBottleneckParts (common/telemetry/metric_table.h)
  std::string advice;  // one sentence
};

// The shares of the run's time by activity, adding up to 1 (all 0: not known). The learner's own work counts as
// measured. The time that the learner waits for fragments is divided by the activities of its actors. `permits` is the
// part in which actors wait although the learner is not working; `intake` remains if no actor plays.
ByActivity FleetTimes(const FleetView& view);

// Reports what is missing or slow, if anything. Otherwise, once an iteration has ended, reports what to add: actors if
// training waits for evaluations at least half the time; a faster learner if it works that much and, where play goes on
// during updates, no less of it than the actors play; else whatever shortens the largest part of its waiting.
Bottleneck FindBottleneck(const FleetView& view);

// Makes the input of FindBottleneck from the workers and the training thread's recent work, `trainer`.
FleetView ViewFleet(const Work& trainer, const std::vector<WorkerRegistry::WorkerInfo>& workers);

// Adds the numbers of workers by role and health.
void CountWorkers(const std::vector<WorkerRegistry::WorkerInfo>& workers, v1::FleetSummary* summary);

// FleetTimes and FindBottleneck of `view`, with the run's state.
v1::FleetSummary SummarizeFleet(const FleetView& view);

}  // namespace craftfleet
