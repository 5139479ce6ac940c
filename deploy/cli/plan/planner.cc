#include "deploy/cli/plan/planner.h"

#include <algorithm>
#include <cmath>
#include <string>
#include <utility>
#include <vector>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>

namespace craftfleet {
namespace {

constexpr double kMicros = 1e6;
constexpr double kTcpShare = 1448.0 / 1538;  // of an Ethernet link: what its frames of 1,500 bytes have of a message
constexpr double kSpare = 1.2;               // actor threads to start for each that must play at any moment
constexpr double kWorthwhile = 1.05;         // rate of a remedy, of the plan's
constexpr double kViewSeconds = 10;          // what the view covers

int CeilOf(int value, int by) { return (value + by - 1) / by; }

int TilesOf(const v1::RunConfig& config) { return CeilOf(config.lanes(), config.tile()); }

bool PlaysOn(const v1::RunConfig& config) { return config.overlap() > 0 || config.max_staleness() > 0; }

// Searches the fleets of one run.
class Planner {
 public:
  Planner(const Costs& costs, const v1::RunConfig& config, FrameFormat format, const Machines& machines)
      : costs_(costs),
        config_(config),
        format_(format),
        frame_(costs[format]),
        machines_(machines),
        worker_us_(costs.act_us + frame_.actor_us + frame_.server_us) {}

  FleetPlan Best() {
    Try(1, std::min(machines_.cores, machines_.host_cores));
    const int hosts = CeilOf(machines_.cores, machines_.host_cores);
    if (hosts > 1) Try(hosts, machines_.cores);
    best_.view = ViewOf(best_);
    best_.limit = LimitOf(best_);
    return best_;
  }

 private:
  // Tries all fleets of `hosts` hosts with `cores` cores together.
  void Try(int hosts, int cores) {
    const int host_cores = std::min(machines_.host_cores, cores);
    const int learners = machines_.gpus > 0 ? 1 : std::min({hosts, machines_.max_learners, config_.gradient_shards()});
    for (int learner = 1; learner <= learners; ++learner) {
      const int useful = machines_.gpus > 0 ? 1 : CeilOf(config_.gradient_shards(), learner);
      for (int threads = 1; threads <= std::min(host_cores, useful); ++threads) {
        if (learner * threads > cores) break;
        FleetPlan plan;
        plan.hosts = hosts;
        plan.learners = learner;
        plan.learner_threads = threads;
        TryActors(cores, host_cores, plan);
      }
    }
  }

  // Tries all numbers of actors beside the learners of `plan`.
  void TryActors(int cores, int host_cores, FleetPlan plan) {
    // On one host all processes share the cores. On several, a learner that never waits has its cores to itself.
    const bool apart = plan.hosts > 1 && PlaysOn(config_);
    const int playing_cores = apart ? cores - plan.learners * plan.learner_threads : cores;
    const int most = std::min(playing_cores, TilesOf(config_));
    for (int actors = 1; most >= 1 && actors <= CeilOf(most, host_cores); ++actors) {
      plan.actors = actors;
      plan.env_servers = actors;
      plan.actor_threads = std::min(most, actors * host_cores);
      plan.lacks_lanes = plan.actor_threads == most && most < playing_cores;
      Rate(cores, &plan);
      if (plan.steps_per_second > best_.steps_per_second * (1 + 1e-9)) best_ = plan;
    }
  }

  // The speed of `plan`, whose processes are known.
  void Rate(int cores, FleetPlan* plan) const {
    const double work = UpdateWork() + frame_.learner_us + worker_us_;
    plan->update_us = UpdateTime(*plan);
    plan->link_us = plan->hosts > 1 ? LinkTime(*plan) : 0;
    const double playing = worker_us_ / plan->actor_threads;
    double step_us = 0;
    if (PlaysOn(config_)) {
      step_us = std::max({plan->update_us, playing, plan->link_us, work / cores});
      const int enough = static_cast<int>(std::ceil(kSpare * worker_us_ / step_us));
      plan->lacks_lanes &= enough >= plan->actor_threads;
      plan->actor_threads = std::min(plan->actor_threads, std::max(enough, plan->actors));
      plan->play_us = std::max(worker_us_ / plan->actor_threads, plan->link_us);
    } else {
      plan->play_us = std::max({playing, plan->link_us, (worker_us_ + frame_.learner_us) / cores});
      step_us = plan->update_us + plan->play_us;
    }
    plan->steps_per_second = kMicros / step_us;
    plan->cores_used = work / step_us;
  }

  // Elapsed time a step.
  double UpdateTime(const FleetPlan& plan) const {
    const int epochs = config_.ppo().epochs();
    if (machines_.gpus > 0) return epochs * *costs_.gpu_update_us;
    const int parallel = plan.learners * plan.learner_threads;
    const double computing = epochs * UpdateMicros(costs_, config_.gradient_shards(), parallel);
    if (plan.learners == 1) return computing;
    // Learners form a chain. Each passes the frames on once, and sends and receives the gradient twice a minibatch.
    const double gradients = 2.0 * epochs * costs_.weight_bytes / config_.ppo().minibatch_size();
    return computing + SendingTime(costs_[FrameFormat::kRaw].bytes + gradients);
  }

  // CPU time a step. A learner's thread waits actively for its GPU.
  double UpdateWork() const {
    const int epochs = config_.ppo().epochs();
    return epochs * (machines_.gpus > 0 ? *costs_.gpu_update_us : costs_.update_us);
  }

  // Elapsed time a step on the learner's link: it receives steps, and sends weights to each actor once an iteration.
  double LinkTime(const FleetPlan& plan) const {
    const double weights = costs_.weight_bytes * plan.actors / config_.ppo().rollout_steps();
    return SendingTime(frame_.bytes + weights);
  }

  double SendingTime(double bytes) const {
    return machines_.gbit > 0 ? kMicros * bytes * 8 / (machines_.gbit * 1e9 * kTcpShare) : 0;
  }

  // Whether actors wait for the link.
  static bool IsLinkFull(const FleetPlan& plan) { return plan.link_us > 0 && plan.play_us == plan.link_us; }

  FleetView ViewOf(const FleetPlan& plan) const {
    const double steps = plan.steps_per_second * kViewSeconds / kMicros;  // times microseconds a step: seconds
    FleetView view;
    view.actors = plan.actors;
    view.env_servers = plan.env_servers;
    view.steps_per_second = plan.steps_per_second;
    view.plays_on = PlaysOn(config_);
    view.learner[Activity::kUpdate] = steps * plan.update_us;
    view.learner[Activity::kIntake] = kViewSeconds - steps * plan.update_us;
    const double sending = IsLinkFull(plan) ? plan.actor_threads * plan.link_us - worker_us_ : 0;
    view.actors_times[Activity::kEnvironment] = steps * frame_.game_us;
    view.actors_times[Activity::kInference] = steps * costs_.act_us;
    view.actors_times[Activity::kWire] = steps * (worker_us_ - frame_.game_us - costs_.act_us + sending);
    view.actors_times[Activity::kPermits] = std::max(0.0, plan.actor_threads * kViewSeconds - view.actors_times.Sum());
    return view;
  }

  Bottleneck LimitOf(const FleetPlan& plan) const {
    Bottleneck limit = FindBottleneck(plan.view);
    if (limit.part == "learner") return limit;
    if (IsLinkFull(plan)) {
      const bool scene = format_ == FrameFormat::kScene;
      limit = {"wire", absl::StrFormat("The learner's network link is full: take a faster one%s.",
                                       scene ? "" : ", or send scene records (--frames=scene)")};
    } else if (plan.lacks_lanes) {
      limit.advice = absl::StrFormat("%d threads play all %d lanes: train with more lanes (--lanes).",
                                     plan.actor_threads, config_.lanes());
    }
    return limit;
  }

  const Costs& costs_;
  const v1::RunConfig& config_;
  const FrameFormat format_;
  const FrameCosts& frame_;
  const Machines& machines_;
  const double worker_us_;  // of actor and environment server together
  FleetPlan best_;
};

// What might help, with the words for it.
std::vector<std::pair<std::string, Machines>> BetterMachines(const Costs& costs, const Machines& machines) {
  Machines cores = machines;
  cores.cores *= 2;
  std::vector<std::pair<std::string, Machines>> better;
  if (machines.cores <= machines.host_cores) {
    cores.host_cores = cores.cores;
    better.emplace_back("twice the cores", cores);
  } else {
    better.emplace_back("twice the hosts", cores);
    Machines hosts = machines;
    hosts.host_cores *= 2;
    better.emplace_back("the same cores on half the hosts", hosts);
    Machines learners = machines;
    learners.max_learners *= 2;
    better.emplace_back(absl::StrFormat("--learners=%d", learners.max_learners), learners);
    Machines network = machines;
    network.gbit *= 10;
    better.emplace_back("a network ten times as fast", network);
  }
  if (machines.gpus == 0 && costs.gpu_update_us.has_value()) {
    Machines gpu = machines;
    gpu.gpus = 1;
    better.emplace_back("a GPU (--gpus=1)", gpu);
  }
  return better;
}

std::vector<std::pair<std::string, v1::RunConfig>> FasterRuns(const v1::RunConfig& config) {
  std::vector<std::pair<std::string, v1::RunConfig>> faster;
  if (!PlaysOn(config)) {
    v1::RunConfig overlapped = config;
    overlapped.set_overlap(1);
    faster.emplace_back("--overlap=1", overlapped);
  }
  if (config.ppo().rollout_steps() % (2 * config.lanes()) == 0) {
    v1::RunConfig lanes = config;
    lanes.set_lanes(2 * config.lanes());
    faster.emplace_back(absl::StrCat("--lanes=", lanes.lanes()), lanes);
  }
  if (config.ppo().minibatch_size() % (2 * config.gradient_shards()) == 0) {
    v1::RunConfig shards = config;
    shards.set_gradient_shards(2 * config.gradient_shards());
    faster.emplace_back(absl::StrCat("gradient_shards: ", shards.gradient_shards()), shards);
  }
  if (config.ppo().epochs() > 1) {
    v1::RunConfig epochs = config;
    epochs.mutable_ppo()->set_epochs(config.ppo().epochs() / 2);
    faster.emplace_back(absl::StrFormat("ppo { epochs: %d }, which changes what is learned", epochs.ppo().epochs()),
                        epochs);
  }
  return faster;
}

}  // namespace

double UpdateMicros(const Costs& costs, int shards, int parallel) {
  const int threads = std::min(parallel, shards);
  if (threads == 1) return costs.update_us;
  double serial = 0;
  if (costs.two_thread_us.has_value()) {  // with two shards
    serial = std::clamp(2 * *costs.two_thread_us / costs.update_us - 1, 0.0, 1.0);
  }
  return costs.update_us * (serial + (1 - serial) * CeilOf(shards, threads) / shards);
}

FleetPlan PlanFleet(const Costs& costs, const v1::RunConfig& config, FrameFormat format, const Machines& machines) {
  return Planner(costs, config, format, machines).Best();
}

std::vector<Remedy> FindRemedies(const Costs& costs, const v1::RunConfig& config, FrameFormat format,
                                 const Machines& machines) {
  const double rate = PlanFleet(costs, config, format, machines).steps_per_second;
  std::vector<Remedy> remedies;
  const auto consider = [&](std::string change, const Machines& with, const v1::RunConfig& run, FrameFormat frames) {
    const double faster = PlanFleet(costs, run, frames, with).steps_per_second;
    if (faster > kWorthwhile * rate) remedies.push_back({std::move(change), faster});
  };
  for (const auto& [change, with] : BetterMachines(costs, machines)) consider(change, with, config, format);
  for (const auto& [change, run] : FasterRuns(config)) consider(change, machines, run, format);
  if (format != FrameFormat::kScene) consider("--frames=scene", machines, config, FrameFormat::kScene);
  std::stable_sort(remedies.begin(), remedies.end(),
                   [](const Remedy& a, const Remedy& b) { return a.steps_per_second > b.steps_per_second; });
  return remedies;
}

}  // namespace craftfleet
