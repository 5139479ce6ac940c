// craftfleet plan: how large a fleet should be.

#include <cstdio>
#include <optional>
#include <string>
#include <utility>

#include <absl/flags/flag.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/string_view.h>
#include <absl/time/time.h>

#include "common/agent/device.h"
#include "common/agent/torch_setup.h"
#include "common/base/frame_format.h"
#include "common/base/status_macros.h"
#include "common/config/config.h"
#include "common/io/files.h"
#include "common/process/cpu_pin.h"
#include "common/process/cpu_quota.h"
#include "common/process/flag_check.h"
#include "common/process/flag_values.h"
#include "common/process/program.h"
#include "common/process/version.h"
#include "common/telemetry/log.h"
#include "common/wire/channel.h"
#include "deploy/cli/plan/costs.h"
#include "deploy/cli/plan/measure.h"
#include "deploy/cli/plan/plan_text.h"
#include "learner/runnable_config.h"

ABSL_FLAG(std::optional<std::string>, agent, std::nullopt, "agent of the run [ppo_cnn]");
ABSL_FLAG(std::string, config, "",
          "file with the run's configuration in protobuf text format; other flags override its values");
ABSL_FLAG(std::optional<int32_t>, lanes, std::nullopt, "games played side by side [the agent's, mostly 16]");
ABSL_FLAG(std::optional<int32_t>, overlap, std::nullopt, "1: play goes on during updates, 0..1 [0]");
ABSL_FLAG(std::optional<int32_t>, max_staleness, std::nullopt, "from 1 on: asynchronous play, 0..64 [0]");
ABSL_FLAG(std::optional<int32_t>, cores, std::nullopt,
          "CPU cores of the fleet, of all hosts together, 1..1000000 [those of this machine]");
ABSL_FLAG(std::optional<int32_t>, host_cores, std::nullopt,
          "CPU cores of each host, 1..1000000 [all; with --gbit, those of this machine]");
ABSL_FLAG(double, gbit, 0, "speed of each host's network link, Gbit/s, 0..100000; 0: as fast as needed");
ABSL_FLAG(int32_t, gpus, 0,
          "GPUs for updates, 0..1; what one costs is measured where --device is one, or comes with --costs\n"
          "several learners compute on CPUs only");
ABSL_FLAG(int32_t, learners, 256, "the most learners to plan for, 1..256; no more than help, and at most one a host");
ABSL_FLAG(std::string, frames, "scene", "how frames travel: raw, lz4 or scene, as craftfleet-actor --frames");
ABSL_FLAG(bool, measure, false,
          "measure again, although there are costs\n"
          "without it costs are kept, and measured anew if the CPU, the build, the agent or another field of the\n"
          "configuration on which they depend has changed");
ABSL_FLAG(std::string, costs, "",
          "file with costs, such as those of another machine: used as they are, or with --measure written\n"
          "[AGENT.json in ~/.cache/craftfleet/costs]");
ABSL_FLAG(craftfleet::TimeSpan, measure_time, {absl::Seconds(45)},
          "how long to measure, 0.1s..1h; large agents take longer, since each part is done at least once");
ABSL_FLAG(std::string, device, "auto",
          "GPU whose updates are measured too: auto (if there is one), cpu (none), cuda or cuda:N");
ABSL_FLAG(bool, json, false, "print JSON");

namespace craftfleet {
namespace {

constexpr char kProgram[] = "craftfleet plan";
constexpr char kUsage[] =
    R"(craftfleet plan says how many learners, actors and environment servers to start, what rate to expect, what will limit it,
and what would help. It measures for a minute what a step costs on this machine, and keeps that.

  craftfleet plan
  craftfleet plan --agent=lstm_cnn --cores=64 --gbit=10
  craftfleet plan --cores=64 --host_cores=16 --gbit=1 --frames=raw --overlap=1
  craftfleet plan --cores=32 --gpus=1 --costs=costs-of-the-gpu-machine.json

A plan assumes that all hosts are like the measured machine and do nothing else. What a GPU costs is only known where it
has been measured: craftfleet plan --measure --device=cuda --costs=FILE, on a machine with one.)";

absl::StatusOr<v1::RunConfig> ConfigFromFlags() {
  v1::RunConfig config;
  const std::string path = absl::GetFlag(FLAGS_config);
  if (!path.empty()) {
    absl::StatusOr<std::string> text = ReadFile(path);
    if (!text.ok()) return absl::Status(text.status().code(), absl::StrCat("--config: ", text.status().message()));
    CRAFTFLEET_ASSIGN_OR_RETURN(config, ParseRunConfig(*text, path));
  }
  if (const auto agent = absl::GetFlag(FLAGS_agent)) config.set_agent(*agent);
  if (const auto lanes = absl::GetFlag(FLAGS_lanes)) config.set_lanes(*lanes);
  if (const auto overlap = absl::GetFlag(FLAGS_overlap)) config.set_overlap(*overlap);
  if (const auto staleness = absl::GetFlag(FLAGS_max_staleness)) config.set_max_staleness(*staleness);
  return CompleteConfig(std::move(config));
}

absl::StatusOr<Machines> MachinesFromFlags() {
  constexpr int kMostCores = 1000000;
  Machines machines;
  machines.cores = absl::GetFlag(FLAGS_cores).value_or(DefaultThreads());
  CRAFTFLEET_RETURN_IF_ERROR(CheckFlagRange("cores", machines.cores, 1, kMostCores));
  machines.gbit = absl::GetFlag(FLAGS_gbit);
  CRAFTFLEET_RETURN_IF_ERROR(CheckFlagRange("gbit", machines.gbit, 0.0, 1e5));
  const int host_cores = machines.gbit > 0 ? DefaultThreads() : machines.cores;
  machines.host_cores = absl::GetFlag(FLAGS_host_cores).value_or(host_cores);
  CRAFTFLEET_RETURN_IF_ERROR(CheckFlagRange("host_cores", machines.host_cores, 1, kMostCores));
  machines.gpus = absl::GetFlag(FLAGS_gpus);
  CRAFTFLEET_RETURN_IF_ERROR(CheckFlagRange("gpus", machines.gpus, 0, 1));
  machines.max_learners = absl::GetFlag(FLAGS_learners);
  CRAFTFLEET_RETURN_IF_ERROR(CheckFlagRange("learners", machines.max_learners, 1, 256));
  return machines;
}

absl::StatusOr<Costs> ReadCosts(const std::string& path) {
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string text, ReadFile(path));
  return ParseCosts(text, path);
}

// Whether `costs` are those that a measurement here would find.
bool AreOurs(const Costs& costs, const v1::RunConfig& config) {
  return costs.cpu == CpuDescription() && costs.build == BuildId() && costs.config == CostlyFields(config);
}

absl::StatusOr<Costs> MeasureAndKeep(const v1::RunConfig& config, const std::string& path) {
  const absl::Duration time = absl::GetFlag(FLAGS_measure_time).value;
  if (time < absl::Milliseconds(100) || time > absl::Hours(1)) {
    return InvalidFlag("measure_time", absl::FormatDuration(time), "0.1s..1h");
  }
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string device, FindDevice(absl::GetFlag(FLAGS_device)));
  SetUpDevice(device, config.precision());
  LogInfo("measuring what %s costs here: some %s", config.agent(), absl::FormatDuration(time));
  CRAFTFLEET_ASSIGN_OR_RETURN(const Costs costs, MeasureCosts(config, device, time));
  CRAFTFLEET_RETURN_IF_ERROR(KeepCosts(costs, path));
  LogInfo("costs are in %s", path);
  return costs;
}

absl::StatusOr<Costs> CostsFromFlags(const v1::RunConfig& config) {
  const std::string given = absl::GetFlag(FLAGS_costs);
  if (!given.empty() && !absl::GetFlag(FLAGS_measure)) {
    CRAFTFLEET_ASSIGN_OR_RETURN(Costs costs, ReadCosts(given));
    if (costs.config != CostlyFields(config)) {
      return absl::InvalidArgumentError(absl::StrCat(
          "--costs: ", given, " has the costs of another run: ", costs.config, "; want ", CostlyFields(config)));
    }
    return costs;
  }
  std::string path = given;
  if (path.empty()) {
    CRAFTFLEET_ASSIGN_OR_RETURN(path, DefaultCostsPath(config.agent()));
  }
  if (!absl::GetFlag(FLAGS_measure)) {
    absl::StatusOr<Costs> kept = ReadCosts(path);
    if (kept.ok() && AreOurs(*kept, config)) return kept;
  }
  return MeasureAndKeep(config, path);
}

absl::Status Run() {
  PlanRequest request;
  const std::string frames = absl::GetFlag(FLAGS_frames);
  const std::optional<FrameFormat> format = FindFrameFormat(frames);
  if (!format.has_value()) return InvalidFlag("frames", frames, "raw, lz4 or scene");
  request.frames = *format;
  request.config_file = absl::GetFlag(FLAGS_config);
  CRAFTFLEET_ASSIGN_OR_RETURN(request.machines, MachinesFromFlags());
  CRAFTFLEET_ASSIGN_OR_RETURN(request.config, ConfigFromFlags());
  CRAFTFLEET_RETURN_IF_ERROR(PinCpu(request.config.cpu()));
  SetUpTorchThread();
  CRAFTFLEET_ASSIGN_OR_RETURN(request.costs, CostsFromFlags(request.config));
  if (request.machines.gpus > 0 && !request.costs.gpu_update_us.has_value()) {
    return absl::FailedPreconditionError(
        absl::StrCat("--gpus=", request.machines.gpus,
                     ": no update has been measured on a GPU; do so on a machine with one (craftfleet plan --measure "
                     "--device=cuda --costs=FILE), and plan with --costs=FILE"));
  }
  std::fputs((absl::GetFlag(FLAGS_json) ? PlanJson(request) : PlanText(request)).c_str(), stdout);
  return absl::OkStatus();
}

}  // namespace
}  // namespace craftfleet

int main(int argc, char** argv) {
  craftfleet::ParseFlags(craftfleet::kProgram, craftfleet::kUsage, argc, argv,
                         {"agent", "cores", "host_cores", "gbit", "gpus", "lanes", "overlap", "max_staleness", "frames",
                          "measure", "costs", "json"});
  craftfleet::wire::PollFewConnections();
  return craftfleet::ExitCode(craftfleet::kProgram, craftfleet::Run());
}
