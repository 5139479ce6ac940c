#include "common/metric_table.h"

#include <array>

#include <absl/strings/match.h>
#include <absl/strings/str_cat.h>

namespace craftfleet {
namespace {

constexpr bool kCounter = true;
constexpr bool kGauge = false;
constexpr char kAll[] = "learner, actor, envserver";

constexpr MetricInfo kTable[] = {
    // Every process.
    {"uptime", kGauge, "s", kAll, "Time since the process began to serve."},
    {"cpu_time", kCounter, "s", kAll, "CPU time of the process, user and system."},
    {"resident_memory", kGauge, "bytes", kAll, "Memory of the process that is in RAM."},
    {"open_files", kGauge, "", kAll, "Open file descriptors, sockets included."},
    {"log_warnings", kCounter, "", kAll, "Warnings logged."},
    {"log_errors", kCounter, "", kAll, "Errors logged: each wants a person."},

    {"info", kGauge, "", kAll, "Always 1; labels say which program and run this is.", "name, version, run_id"},
    {"activity_time", kCounter, "s", kAll, "Time of all working threads by what they did.", "activity"},
    {"time_share", kGauge, "", kAll, "Share of the working threads' time in the last seconds, 0 to 1.", "activity"},
    {"threads", kGauge, "", kAll,
     "Threads whose time that is: the trainer, an actor's playing threads, a server's sessions."},

    {"env_steps", kCounter, "steps", kAll,
     "Environment steps: accepted (learner), played (actor), stepped (envserver). The learner's go on over restarts."},
    {"steps_per_second", kGauge, "steps/s", kAll,
     "Environment steps a second: of the last iterations (learner), of the last 20 seconds (others)."},
    {"lanes", kGauge, "lanes", kAll, "Games: of the run (learner), with a permit here (actor), open here (envserver)."},
    {"policy_version", kGauge, "", "learner, actor",
     "Version of the weights last published (learner), last played (actor)."},

    // The learner: the run.
    {"env_steps_goal", kGauge, "steps", "learner", "Environment steps after which the run is complete."},
    {"iteration", kGauge, "", "learner", "Iterations of PPO finished."},
    {"epoch", kGauge, "", "learner", "How often the run was started or resumed."},
    {"episodes", kCounter, "episodes", "learner, envserver",
     "Training episodes finished (learner), episodes ended here (envserver)."},
    {"reward", kGauge, "", "learner", "Mean reward of the last 100 training episodes."},
    {"episode_length", kGauge, "steps", "learner", "Mean length of the last 100 training episodes."},
    {"crafter_score", kGauge, "", "learner", "Crafter score over all training episodes, 0 to 100."},
    {"achievements_unlocked", kGauge, "", "learner", "Achievements unlocked so far, 0 to 22."},
    {"checkpoint_age", kGauge, "s", "learner",
     "Time since the last checkpoint was written, or since the start without one."},
    // The learner: its fleet.
    {"fleet_time_share", kGauge, "", "learner", "Where a second of the run goes, 0 to 1.", "activity"},
    {"fleet_bottleneck", kGauge, "", "learner", "1 for what holds the fleet back, 0 for the rest.", "part"},
    {"workers", kGauge, "", "learner", "Actors and environment servers by what was last heard of them.",
     "worker, state"},
    // The learner: intake.
    {"fragments_accepted", kCounter, "fragments", "learner, actor", "Fragments that count."},
    {"fragments_duplicate", kCounter, "fragments", "learner", "Fragments that came again, after a lost answer."},
    {"fragments_expired", kCounter, "fragments", "learner", "Fragments whose permit had gone to another actor."},
    {"fragments_rejected", kCounter, "fragments", "learner", "Fragments of a wrong shape or version."},
    {"permits_lapsed", kCounter, "", "learner", "Permits taken back from actors that fell silent."},
    {"fragments_queued", kGauge, "fragments", "learner", "Fragments that wait for the trainer."},

    // Actors.
    {"fragments_refused", kCounter, "fragments", "actor",
     "Fragments that came too late for the learner, or that it rejected."},
    {"fragments_resent", kCounter, "fragments", "actor", "Fragments sent again after the connection broke."},
    {"fragments_abandoned", kCounter, "fragments", "actor", "Fragments begun and not finished."},

    // Environment servers.
    {"sessions", kGauge, "", "envserver", "Playing threads of actors that are connected."},
    {"sessions_rejected", kCounter, "", "envserver", "Sessions ended by a bad request or handshake."},
};

}  // namespace

absl::Span<const MetricInfo> MetricTable() { return kTable; }

const MetricInfo* FindMetric(absl::string_view name) {
  for (const MetricInfo& metric : kTable) {
    if (metric.name == name) return &metric;
  }
  return nullptr;
}

std::string PrometheusName(const MetricInfo& metric) {
  std::string name = absl::StrCat("craftfleet_", metric.name);
  if (metric.unit == "s") {
    const bool says_time = absl::EndsWith(name, "_time");
    if (says_time) name.resize(name.size() - 5);
    name += "_seconds";
  }
  if (metric.unit == "bytes") name += "_bytes";
  if (metric.counter) name += "_total";
  return name;
}

}  // namespace craftfleet
