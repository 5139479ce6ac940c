#include "deploy/cli/plan/plan_text.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/strings/str_join.h>
#include <nlohmann/json.hpp>

#include "common/base/numbers.h"
#include "common/telemetry/activity.h"

namespace craftfleet {
namespace {

// The flag that asks for the run's mode.
std::string ModeOf(const v1::RunConfig& config) {
  if (config.max_staleness() > 0) return absl::StrCat("--max_staleness=", config.max_staleness());
  return config.overlap() > 0 ? "--overlap=1" : "synchronous";
}

v1::RunConfig WithMode(v1::RunConfig config, int overlap) {
  config.set_overlap(overlap);
  config.set_max_staleness(0);
  return config;
}

FleetPlan PlanOf(const PlanRequest& request, const v1::RunConfig& config) {
  return PlanFleet(request.costs, config, request.frames, request.machines);
}

double WorkingShare(const FleetPlan& plan) { return plan.update_us * plan.steps_per_second / 1e6; }

std::string CostsText(const PlanRequest& request) {
  const Costs& costs = request.costs;
  const FrameCosts& frame = costs[request.frames];
  const int epochs = request.config.ppo().epochs();
  std::string text = absl::StrFormat("A step costs, on one core of %s (measured %s):\n", costs.cpu, costs.measured);
  absl::StrAppendFormat(&text, "  learner             %8.1f us  %d x %.1f to learn from it (%s), %.1f to receive it\n",
                        epochs * costs.update_us + frame.learner_us, epochs, costs.update_us,
                        epochs == 1 ? "1 epoch" : absl::StrCat(epochs, " epochs"), frame.learner_us);
  absl::StrAppendFormat(&text, "  actor               %8.1f us  %.1f to choose the action, %.1f for messages\n",
                        costs.act_us + frame.actor_us, costs.act_us, frame.actor_us);
  absl::StrAppendFormat(&text, "  environment server  %8.1f us  %.1f for the game, %.1f for messages\n",
                        frame.server_us, frame.game_us, frame.server_us - frame.game_us);
  absl::StrAppendFormat(&text, "  network             %8.0f bytes to the learner (--frames=%s)\n", frame.bytes,
                        FrameFormatName(request.frames));
  if (costs.gpu_update_us.has_value()) {
    absl::StrAppendFormat(&text, "  a GPU               %8.1f us  %d x %.1f to learn from it\n",
                          epochs * *costs.gpu_update_us, epochs, *costs.gpu_update_us);
  }
  if (request.config.distillation().every_iterations() > 0) absl::StrAppend(&text, "Not counted: distillation.\n");
  return text;
}

std::string MachinesText(const Machines& machines, const FleetPlan& plan) {
  std::string text = Counted(machines.cores, "core");
  if (machines.gpus > 0) absl::StrAppend(&text, " and ", Counted(machines.gpus, "GPU"));
  const int hosts = (machines.cores + machines.host_cores - 1) / machines.host_cores;
  absl::StrAppend(&text,
                  hosts == 1 ? " on one host" : absl::StrFormat(" on %d hosts of %d", hosts, machines.host_cores));
  if (hosts > 1 && machines.gbit > 0) absl::StrAppendFormat(&text, ", %g Gbit/s", machines.gbit);
  if (hosts == 1 && machines.gbit > 0) absl::StrAppend(&text, " (nothing travels over the network)");
  if (plan.hosts < hosts) absl::StrAppend(&text, "; one of them is as fast as all");
  return text;
}

std::string ModesText(const PlanRequest& request, const FleetPlan& plan) {
  const auto row = [](absl::string_view mode, const FleetPlan& fleet) {
    return absl::StrFormat("  %-32s %10s %14.0f%%   %s\n", mode, WithCommas(std::lround(fleet.steps_per_second)),
                           100 * WorkingShare(fleet), fleet.limit.part);
  };
  std::string text = absl::StrFormat("%s:\n  %-32s %10s %15s   %s\n", MachinesText(request.machines, plan), "",
                                     "steps/s", "learner works", "limited by");
  absl::StrAppend(&text, row("synchronous, the default", PlanOf(request, WithMode(request.config, 0))));
  absl::StrAppend(&text, row("--overlap=1 or --max_staleness=N", PlanOf(request, WithMode(request.config, 1))));
  return text;
}

std::string RunFlags(const PlanRequest& request) {
  const v1::RunConfig& config = request.config;
  std::string flags = absl::StrCat("--agent=", config.agent(), " --lanes=", config.lanes());
  if (!request.config_file.empty()) flags = absl::StrCat("--config=", request.config_file, " ", flags);
  if (ModeOf(config) != "synchronous") absl::StrAppend(&flags, " ", ModeOf(config));
  return flags;
}

struct Command {
  std::string where;  // for people
  std::string command;
};

// The commands that start the fleet. On one host they are alternatives.
std::vector<Command> Commands(const PlanRequest& request, const FleetPlan& plan) {
  const std::string run = RunFlags(request);
  if (plan.hosts == 1) {
    const std::string flags =
        absl::StrFormat("%s --threads=%d --logdir=runs/plan", run, std::max(plan.learner_threads, plan.actor_threads));
    return {{"in one process", "craftfleet train " + flags},
            {"or in processes of their own", "deploy/local-fleet.sh --actors=1 --envservers=1 " + flags}};
  }
  const std::string learner =
      absl::StrFormat("craftfleet-learner %s --threads=%d --logdir=runs/plan", run, plan.learner_threads);
  const std::string ranks = plan.learners == 1 ? "" : absl::StrFormat(" --world_size=%d --rank=", plan.learners);
  std::vector<Command> commands = {
      {"on host A", absl::StrCat(learner, " --listen=0.0.0.0:50051 --insecure", ranks, plan.learners == 1 ? "" : "0")}};
  if (plan.learners > 1) {
    commands.push_back({absl::StrFormat("on %s, with N = 1, 2, ...", Counted(plan.learners - 1, "further host")),
                        absl::StrCat(learner, ranks, "N --master_addr=A")});
  }
  const std::string where =
      plan.actors == 1 ? "on a host that plays" : absl::StrFormat("on each of %d hosts that play", plan.actors);
  commands.push_back({where, "craftfleet-envserver --listen=127.0.0.1:50061"});
  commands.push_back(
      {where,
       absl::StrFormat(
           "craftfleet-actor --learner=A:50051 --envservers=127.0.0.1:50061 --threads=%d%s",
           (plan.actor_threads + plan.actors - 1) / plan.actors,
           request.frames == FrameFormat::kScene ? "" : absl::StrCat(" --frames=", FrameFormatName(request.frames)))});
  return commands;
}

std::string StartText(const PlanRequest& request, const FleetPlan& plan) {
  std::string text = absl::StrFormat("Start (%s): %s", ModeOf(request.config), Counted(plan.learners, "learner"));
  absl::StrAppend(&text, " with ", Counted(plan.learner_threads, "thread"), plan.learners == 1 ? "" : " each", ", ",
                  Counted(plan.actors, "actor"), " with ", Counted(plan.actor_threads, "thread"),
                  plan.actors == 1 ? "" : " together", ", ", Counted(plan.env_servers, "environment server"), "\n");
  std::string where;
  for (const Command& command : Commands(request, plan)) {
    if (command.where != where) absl::StrAppend(&text, " ", command.where, ":\n");
    where = command.where;
    absl::StrAppend(&text, "  ", command.command, "\n");
  }
  if (plan.hosts > 1) absl::StrAppend(&text, "--insecure is for networks that you trust: deploy/SECURING.md\n");
  return text;
}

std::string SharesText(const FleetPlan& plan) {
  const ByActivity shares = FleetTimes(plan.view);
  std::vector<std::string> parts;
  for (const Activity activity : kActivities) {
    if (shares[activity] < 0.005) continue;
    parts.push_back(absl::StrFormat("%s %.0f%%", ActivityName(activity), 100 * shares[activity]));
  }
  return absl::StrFormat("At best %s steps/s, with %.1f cores busy; time: %s\n",
                         WithCommas(std::lround(plan.steps_per_second)), plan.cores_used, absl::StrJoin(parts, "  "));
}

std::string RemediesText(const PlanRequest& request) {
  const std::vector<Remedy> remedies = FindRemedies(request.costs, request.config, request.frames, request.machines);
  if (remedies.empty()) return "Nothing that this program knows makes it 5% faster.\n";
  std::string text = "What would help:\n";
  for (const Remedy& remedy : remedies) {
    absl::StrAppendFormat(&text, "  %10s steps/s  %s\n", WithCommas(std::lround(remedy.steps_per_second)),
                          remedy.change);
  }
  return text;
}

nlohmann::ordered_json ToJson(const PlanRequest& request, const FleetPlan& plan) {
  const ByActivity times = FleetTimes(plan.view);
  nlohmann::ordered_json shares;
  for (const Activity activity : kActivities) shares[std::string(ActivityName(activity))] = times[activity];
  nlohmann::ordered_json commands = nlohmann::ordered_json::array();
  for (const Command& command : Commands(request, plan)) {
    commands.push_back({{"where", command.where}, {"command", command.command}});
  }
  return {{"hosts", plan.hosts},
          {"learners", plan.learners},
          {"learner_threads", plan.learner_threads},
          {"actors", plan.actors},
          {"actor_threads", plan.actor_threads},
          {"env_servers", plan.env_servers},
          {"steps_per_second", plan.steps_per_second},
          {"learner_works", WorkingShare(plan)},
          {"cores_used", plan.cores_used},
          {"times", std::move(shares)},
          {"bottleneck", plan.limit.part},
          {"advice", plan.limit.advice},
          {"commands", std::move(commands)}};
}

}  // namespace

std::string PlanText(const PlanRequest& request) {
  const FleetPlan plan = PlanOf(request, request.config);
  return absl::StrCat(CostsText(request), "\n", ModesText(request, plan), "\n", StartText(request, plan),
                      SharesText(plan), plan.limit.advice, "\n\n", RemediesText(request));
}

std::string PlanJson(const PlanRequest& request) {
  nlohmann::ordered_json json;
  json["agent"] = request.config.agent();
  json["mode"] = ModeOf(request.config);
  json["plan"] = ToJson(request, PlanOf(request, request.config));
  json["synchronous"] = PlanOf(request, WithMode(request.config, 0)).steps_per_second;
  json["overlapped"] = PlanOf(request, WithMode(request.config, 1)).steps_per_second;
  nlohmann::ordered_json remedies = nlohmann::ordered_json::array();
  for (const Remedy& remedy : FindRemedies(request.costs, request.config, request.frames, request.machines)) {
    remedies.push_back({{"change", remedy.change}, {"steps_per_second", remedy.steps_per_second}});
  }
  json["remedies"] = std::move(remedies);
  json["costs"] = nlohmann::ordered_json::parse(FormatCosts(request.costs));
  return json.dump(2, ' ', /*ensure_ascii=*/false, nlohmann::ordered_json::error_handler_t::replace) + "\n";
}

}  // namespace craftfleet
