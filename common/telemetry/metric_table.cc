#include "common/telemetry/metric_table.h"

#include <absl/strings/match.h>
#include <absl/strings/str_cat.h>

namespace craftfleet {
namespace {

constexpr bool kCounter = true;
constexpr bool kGauge = false;

constexpr MetricInfo kTable[] = {
    // Every process.
    {"uptime", kGauge, "s", "Time since the process began to serve."},
    {"cpu_time", kCounter, "s", "CPU time of the process, user and system."},
    {"resident_memory", kGauge, "bytes", "Resident memory of the process."},
    {"gpu_memory", kGauge, "bytes", "Memory in use on the GPU that the process computes on, by all processes."},
    {"gpu_memory_size", kGauge, "bytes", "Memory of this GPU."},
    {"gpu_utilization", kGauge, "", "Share of the last second in which this GPU computed, 0 to 1."},
    {"open_files", kGauge, "", "Open file descriptors, sockets included."},
    {"log_warnings", kCounter, "", "Warnings logged."},
    {"log_errors", kCounter, "", "Errors logged: each needs a person to act."},

    {"info", kGauge, "", "Always 1; labels say which program and run this is."},
    {"activity_time", kCounter, "s", "Time of all working threads by activity."},
    {"time_share", kGauge, "", "Share of the working threads' time in the last seconds, 0 to 1."},
    {"threads", kGauge, "",
     "Threads whose time is counted: the trainer, an actor's playing threads, a server's sessions."},

    {"env_steps", kCounter, "steps",
     "Environment steps: accepted (learner), played (actor), stepped (envserver). The learner's continue over "
     "restarts."},
    {"steps_per_second", kGauge, "steps/s",
     "Environment steps a second: of the last iterations (learner), of the last 20 seconds (others)."},
    {"lanes", kGauge, "lanes", "Games: of the run (learner), with a permit here (actor), open here (envserver)."},
    {"policy_version", kGauge, "", "Version of the weights last published (learner), last played (actor)."},

    // The learner: the run.
    {"env_steps_goal", kGauge, "steps", "Environment steps after which the run is complete."},
    {"iteration", kGauge, "", "Iterations of PPO finished."},
    {"epoch", kGauge, "", "How often the run was started or resumed."},
    {"episodes", kCounter, "episodes", "Training episodes finished (learner), episodes ended here (envserver)."},
    {"reward", kGauge, "", "Mean reward of the last 100 training episodes."},
    {"episode_length", kGauge, "steps", "Mean length of the last 100 training episodes."},
    {"crafter_score", kGauge, "", "Crafter score over all training episodes, 0 to 100."},
    {"achievements_unlocked", kGauge, "", "Achievements unlocked so far, 0 to 22."},
    {"checkpoint_age", kGauge, "s", "Time since the last checkpoint was written, or since the start without one."},
    // The learner: its fleet.
    {"fleet_time_share", kGauge, "", "Share of the fleet's time by activity, 0 to 1."},
    {"fleet_bottleneck", kGauge, "", "1 for the part that limits the speed of the fleet, 0 for the others."},
    {"workers", kGauge, "", "Actors and environment servers by state."},
    {"workers_mixed", kCounter, "",
     "Times that a worker with another canary asked to join: refused, or admitted by --allow_mixed."},
    // The learner: intake.
    {"fragments_accepted", kCounter, "fragments", "Fragments accepted for training."},
    {"fragments_duplicate", kCounter, "fragments",
     "Fragments received again: after a lost answer, or from a second player."},
    {"fragments_expired", kCounter, "fragments", "Fragments whose permit had been granted to another actor."},
    {"fragments_rejected", kCounter, "fragments", "Fragments of a wrong shape or version, or with impossible values."},
    {"fragments_differing", kCounter, "fragments",
     "Fragments received again with other bytes: one of two actors computes wrong results."},
    {"lanes_reset", kCounter, "", "Lanes reset to an earlier snapshot because the last one could not be restored."},
    {"updates_undone", kCounter, "", "Updates that failed; their iterations are played again."},
    {"fragments_dropped", kCounter, "fragments",
     "Fragments that were not learned from because their weights were older than max_staleness; they are played "
     "again."},
    {"staleness_min", kGauge, "", "Updates since the newest weights that played a fragment of the last update."},
    {"staleness_mean", kGauge, "",
     "Mean number of updates since the weights that played a fragment of the last update."},
    {"staleness_max", kGauge, "", "Updates since the oldest weights that played a fragment of the last update."},
    {"permits_lapsed", kCounter, "",
     "Permits of actors that sent no heartbeat, or whose overdue fragments others finished."},
    {"fragments_queued", kGauge, "fragments", "Fragments that wait for the trainer."},

    // Actors.
    {"fragments_refused", kCounter, "fragments", "Fragments that reached the learner too late, or that it rejected."},
    {"fragments_resent", kCounter, "fragments", "Fragments sent again after the connection broke."},
    {"fragments_abandoned", kCounter, "fragments", "Fragments whose permits were returned unplayed or unfinished."},

    // Environment servers.
    {"sessions", kGauge, "", "Playing threads of actors that are connected."},
    {"games_memory", kGauge, "bytes", "Memory budgeted for the games of all sessions, out of --max_games_mb."},
    {"sessions_rejected", kCounter, "", "Sessions refused, or ended by a bad request, a limit, a timeout or an error."},
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
