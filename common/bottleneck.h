// What holds a fleet back, and what to add.

#ifndef CRAFTFLEET_COMMON_BOTTLENECK_H_
#define CRAFTFLEET_COMMON_BOTTLENECK_H_

#include <string>

#include <absl/strings/string_view.h>

#include "common/activity.h"

namespace craftfleet {

// What the learner knows of its fleet at one moment.
struct FleetView {
  bool finished = false;        // the run is over
  bool paused = false;          // play was paused by hand
  int actors = 0;               // that answer
  int env_servers = 0;          // the same; 0 also where actors don't say
  int lost_env_servers = 0;     // that no longer answer
  double steps_per_second = 0;  // that actors play
  ByActivity learner;           // seconds of its training thread, over the last seconds or iterations
  ByActivity actors_times;      // seconds of all actors' playing threads, the same
};

// "actors" and "environment servers" where there are none; "none": nothing to say.
inline constexpr absl::string_view kBottleneckParts[] = {"none",        "actors", "environment servers", "learner",
                                                         "environment", "wire",   "inference",           "permits"};

struct Bottleneck {
  std::string part;    // one of kBottleneckParts
  std::string advice;  // a sentence
};

// Where a second of the run goes, parts of 1 (all 0: nothing is known). The learner's own work counts as it is. While
// the learner waits for fragments, its actors decide how long: that time is shared out by what they do then. `permits`
// is what they wait beyond the learner's work; `intake` remains where nobody plays.
ByActivity FleetTimes(const FleetView& view);

// Says what to add: learner speed if the learner works at least half the time, else whatever helps with the largest
// part of its waiting.
Bottleneck FindBottleneck(const FleetView& view);

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_BOTTLENECK_H_
