#include "learner/service/fleet_summary.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <optional>
#include <utility>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>

#include "common/wire/status_service.h"
#include "learner/service/worker_page.h"

namespace craftfleet {
namespace {

constexpr double kEnoughSeconds = 2;  // of the learner's time, needed for advice

std::string Percent(double part) { return absl::StrCat(std::lround(100 * part), "%"); }

std::string AnsweringServers(int count) {
  return count == 1 ? "1 environment server answers" : absl::StrCat(count, " environment servers answer");
}

// What the fleet lacks to run at all; an empty part: nothing.
Bottleneck WhatIsMissing(const FleetView& view) {
  if (view.finished) return {"none", "The run is complete."};
  if (view.paused) return {"none", "Play is paused: craftfleet admin resume continues it."};
  if (view.actors == 0) {
    return {"actors", "No actor plays: start craftfleet-actor with --learner set to this learner's address."};
  }
  if (view.drained_actors == view.actors) {
    return {"actors",
            "All actors are drained: start another one, or give one work again with craftfleet admin undrain."};
  }
  if (view.env_servers > 0 && view.drained_env_servers == view.env_servers) {
    return {"environment servers",
            "All environment servers are drained: start another one, or give one games again with craftfleet admin "
            "undrain."};
  }
  if (view.env_servers == 0 && view.lost_env_servers > 0) {
    return {
        "environment servers",
        absl::StrFormat("No environment server answers (%d lost): start craftfleet-envserver again; the actors wait "
                        "for one.",
                        view.lost_env_servers)};
  }
  if (view.evaluating) return {"none", "Training is over; the final evaluation is being played."};
  if (view.steps_per_second > 0) return {};
  if (view.env_servers == 0) {
    return {"environment servers",
            "No environment server is known: start craftfleet-envserver, and pass its address to the actors "
            "(--envservers) or register it with the learner (--learner)."};
  }
  return {};
}

std::string LostServers(const FleetView& view) {
  if (view.lost_env_servers == 0) return "";
  return absl::StrFormat(" (%d of %d lost)", view.lost_env_servers, view.lost_env_servers + view.env_servers);
}

// That a server holds up the games of its actors; nothing where none does.
std::optional<Bottleneck> SlowServer(const FleetView& view) {
  if (view.slow_env_servers.empty()) return std::nullopt;
  const size_t more = view.slow_env_servers.size() - 1;
  const std::string others = more == 0 ? "" : absl::StrFormat(", as %s %d more", more == 1 ? "is" : "are", more);
  return Bottleneck{"environment", absl::StrFormat("Environment server %s is slow%s: look for load, swapping or a full "
                                                   "disk on its machine, or stop it.",
                                                   view.slow_env_servers[0], others)};
}

// The share of the time in which the actors' threads play, rather than wait.
double PlayingShare(const FleetView& view) {
  const ByActivity actors = view.actors_times.Normalized();
  return actors.Sum() - actors[Activity::kPermits] - actors[Activity::kIdle];
}

v1::FleetSummary::RunState RunStateOf(const FleetView& view) {
  if (view.finished) return v1::FleetSummary::COMPLETE;
  if (view.evaluating) return v1::FleetSummary::EVALUATING;
  return view.paused ? v1::FleetSummary::PAUSED : v1::FleetSummary::TRAINING;
}

}  // namespace

FleetView ViewFleet(const Work& trainer, const std::vector<WorkerRegistry::WorkerInfo>& workers) {
  using Health = WorkerRegistry::Health;
  FleetView view;
  view.learner = trainer.times;
  view.early = trainer.times[Activity::kUpdate] == 0;  // times cover at least one whole iteration
  for (const WorkerRegistry::WorkerInfo& info : workers) {
    const Worker& worker = info.worker;
    const bool ok = info.health == Health::kOk || info.health == Health::kSlow;
    if (info.health == Health::kSlow) {
      view.slow_env_servers.push_back(absl::StrFormat("%s (%.0f ms a step)", worker.address, worker.step_ms));
    }
    if (worker.role == WorkerRole::kEnvServer) {
      view.env_servers += ok ? 1 : 0;
      view.drained_env_servers += ok && info.IsDrained() ? 1 : 0;
      view.lost_env_servers += info.health == Health::kLost || info.health == Health::kNotAnswering ? 1 : 0;
    } else if (ok) {
      ++view.actors;
      view.drained_actors += info.IsDrained() ? 1 : 0;
      if (info.summary_is_old || worker.summary == nullptr) continue;
      view.steps_per_second += worker.summary->steps_per_second();
      view.actors_times.Add(wire::TimesOf(*worker.summary));
    }
  }
  return view;
}

void CountWorkers(const std::vector<WorkerRegistry::WorkerInfo>& workers, v1::FleetSummary* summary) {
  std::map<std::pair<WorkerRole, WorkerRegistry::Health>, int> counts;
  for (const WorkerRegistry::WorkerInfo& info : workers) ++counts[{info.worker.role, info.health}];
  for (const auto& [kind, number] : counts) {
    v1::WorkerCount* const count = summary->add_workers();
    count->set_role(RoleName(kind.first));
    count->set_health(ToProto(kind.second));
    count->set_number(number);
  }
}

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
  if (const std::optional<Bottleneck> slow = SlowServer(view); slow.has_value()) return *slow;
  const ByActivity times = FleetTimes(view);
  if (view.early || view.learner.Sum() < kEnoughSeconds || times.Sum() == 0) {
    return {"none", "No iteration has ended yet: advice follows after the first one."};
  }
  const double learner = times[Activity::kUpdate] + times[Activity::kOther];
  const double environment = times[Activity::kEnvironment];
  const double wire = times[Activity::kWire];
  const double inference = times[Activity::kInference];
  const double permits = times[Activity::kPermits] + times[Activity::kIntake];
  const double evaluations = times[Activity::kIdle];
  if (evaluations >= 0.5) {
    return {"actors", absl::StrFormat("Training waits for evaluations %s of the time: add actors, or evaluate less "
                                      "(eval.every_steps, eval.episodes).",
                                      Percent(evaluations))};
  }
  if (learner >= std::max(0.5, view.plays_on ? PlayingShare(view) : 0)) {
    return {"learner", absl::StrFormat("The learner works %s of the time: give it more or faster CPUs (--threads) or a "
                                       "GPU; more actors would only wait for it.",
                                       Percent(learner))};
  }
  // Play limits the speed.
  if (view.steps_per_second == 0 && view.env_servers > 0) {
    return {"permits", absl::StrFormat("The actors play nothing although %s: check the actors' logs.",
                                       AnsweringServers(view.env_servers))};
  }
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
            absl::StrFormat("Messages take %s of the time: add actors, whose waits overlap, or move them closer "
                            "to the environment servers.",
                            Percent(wire))};
  }
  return {"permits", absl::StrFormat("Actors wait for lanes %s of the time while the learner waits for them: run fewer "
                                     "actors, or train with more lanes (--lanes).",
                                     Percent(permits))};
}

v1::FleetSummary SummarizeFleet(const FleetView& view) {
  v1::FleetSummary summary;
  wire::AddShares(FleetTimes(view), summary.mutable_times());
  const Bottleneck bottleneck = FindBottleneck(view);
  summary.set_bottleneck(bottleneck.part);
  summary.set_advice(bottleneck.advice);
  summary.set_run_state(RunStateOf(view));
  return summary;
}

}  // namespace craftfleet
