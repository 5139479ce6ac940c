#include "common/bottleneck.h"

#include <algorithm>
#include <cmath>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>

namespace craftfleet {
namespace {

constexpr double kEnoughSeconds = 2;  // of the learner, to judge by

std::string Percent(double part) { return absl::StrCat(std::lround(100 * part), "%"); }

// What the fleet lacks before its speed is of interest; empty part: nothing.
Bottleneck WhatIsMissing(const FleetView& view) {
  if (view.finished) return {"none", "The run is complete."};
  if (view.paused) return {"none", "Play is paused."};
  if (view.actors == 0) {
    return {"actors", "No actor plays: start craftfleet-actor with --learner set to this learner's address."};
  }
  if (view.steps_per_second > 0) return {};
  if (view.env_servers == 0 && view.lost_env_servers > 0) {
    return {
        "environment servers",
        absl::StrFormat("None of %d environment servers answers: start them again, or others.", view.lost_env_servers)};
  }
  if (view.env_servers == 0) {
    return {"environment servers",
            "No environment server is known: start craftfleet-envserver, and name it to the "
            "actors (--envservers) or register it (--learner)."};
  }
  return {};
}

std::string LostServers(const FleetView& view) {
  if (view.lost_env_servers == 0) return "";
  return absl::StrFormat(" (%d of %d no longer answers)", view.lost_env_servers,
                         view.lost_env_servers + view.env_servers);
}

}  // namespace

ByActivity FleetTimes(const FleetView& view) {
  ByActivity times = view.learner.Normalized();
  const double waiting = times[Activity::kIntake];
  const double working = times.Sum() - waiting;
  const ByActivity actors = view.actors_times.Normalized();
  ByActivity play = actors;
  play[Activity::kPermits] = std::max(0.0, actors[Activity::kPermits] - working);
  play[Activity::kIdle] = 0;
  const bool anyone_plays = actors[Activity::kEnvironment] + actors[Activity::kWire] + actors[Activity::kInference] > 0;
  if (!anyone_plays) return times;
  times[Activity::kIntake] = 0;
  times.Add(play.Normalized(), waiting);
  return times;
}

Bottleneck FindBottleneck(const FleetView& view) {
  if (Bottleneck missing = WhatIsMissing(view); !missing.part.empty()) return missing;
  const ByActivity times = FleetTimes(view);
  if (view.learner.Sum() < kEnoughSeconds || times.Sum() == 0) return {"none", "It is too early to say."};
  const double learner = times[Activity::kUpdate] + times[Activity::kOther];
  const double environment = times[Activity::kEnvironment];
  const double wire = times[Activity::kWire];
  const double inference = times[Activity::kInference];
  const double permits = times[Activity::kPermits] + times[Activity::kIntake];
  if (learner >= 0.5) {
    return {"learner", absl::StrFormat("The learner works %s of the time: give it more or faster CPUs (--threads) or a "
                                       "GPU; more actors would wait for it.",
                                       Percent(learner))};
  }
  // The learner waits for play more than it works.
  const double most = std::max({environment, wire, inference, permits});
  if (most == environment) {
    return {"environment", absl::StrFormat("Games take %s of the time: add environment servers%s.",
                                           Percent(environment), LostServers(view))};
  }
  if (most == inference) {
    return {"inference",
            absl::StrFormat("The policy's inference takes %s of the time: add actors.", Percent(inference))};
  }
  if (most == wire) {
    return {"wire",
            absl::StrFormat("Messages take %s of the time: add actors, whose waits overlap, or move them nearer "
                            "to the environment servers.",
                            Percent(wire))};
  }
  return {"permits", absl::StrFormat("Actors wait for lanes %s of the time while the learner waits for them: run fewer "
                                     "actors, or train with more lanes (--lanes).",
                                     Percent(permits))};
}

}  // namespace craftfleet
