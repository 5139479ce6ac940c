// craftfleet sweep: runs experiments.

#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <iostream>
#include <string>
#include <system_error>
#include <vector>

#include <absl/flags/flag.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/strings/str_join.h>

#include "common/cpu_quota.h"
#include "common/program.h"
#include "common/status_macros.h"
#include "deploy/experiment/experiments.h"
#include "deploy/experiment/run_state.h"
#include "deploy/experiment/sweep.h"
#include "deploy/experiment/sweep_plan.h"

ABSL_FLAG(std::vector<std::string>, experiment, {}, "experiments of the file to run, joined by commas [all]");
ABSL_FLAG(std::vector<std::string>, cell, {},
          "cells to run, joined by commas: ppo_cnn, 94-2-2-2/ppo_cnn, or 94-2-2-2 for all below it [all]");
ABSL_FLAG(int32_t, seeds, 10, "runs of each cell: seeds 1, 2, ...; 1..1000");
ABSL_FLAG(int32_t, jobs, 1, "runs at a time, 1..1000");
ABSL_FLAG(int64_t, steps, 0, "environment steps of each run, to try something; 0: as the experiment says");
ABSL_FLAG(std::string, logdir, "", "folder of the runs: LOGDIR/EXPERIMENT/CELL/seed1, ... (needed to run)");
ABSL_FLAG(bool, list, false, "only list the cells; with --logdir also how many of their runs are done");
ABSL_FLAG(bool, dry_run, false, "only print the commands that would be run");
ABSL_FLAG(std::string, write_configs, "", "only write each cell's configuration to DIR/EXPERIMENT/CELL.txt");
ABSL_FLAG(int32_t, threads, 0, "threads of each run; 0: the CPU quota shared among --jobs");
ABSL_FLAG(std::string, textures, "",
          "textures of all runs, as for craftfleet train [the ones that come with this program]");

namespace craftfleet {
namespace {

constexpr char kProgram[] = "craftfleet sweep";
constexpr char kUsage[] =
    R"(craftfleet sweep FILE runs the experiments of a file, every cell with several seeds, each by `craftfleet train`. Started
again after it was stopped or killed, it goes on: runs that are complete are left as they are, others are resumed. A run
that fails is reported and does not stop the rest. Each run's output is in log.txt in its folder.

  craftfleet sweep deploy/experiments/paper.txt --list
  craftfleet sweep deploy/experiments/paper.txt --experiment=table1 --cell=ppo_cnn --seeds=3 --jobs=2 --logdir=runs/paper
  craftfleet report runs/paper --out=report)";

absl::Status CheckFlags() {
  const auto within = [](absl::string_view flag, int64_t value, int64_t low, int64_t high) {
    if (value >= low && value <= high) return absl::OkStatus();
    return absl::InvalidArgumentError(absl::StrCat("--", flag, "=", value, ", want ", low, "..", high));
  };
  CRAFTFLEET_RETURN_IF_ERROR(within("seeds", absl::GetFlag(FLAGS_seeds), 1, 1000));
  CRAFTFLEET_RETURN_IF_ERROR(within("jobs", absl::GetFlag(FLAGS_jobs), 1, 1000));
  CRAFTFLEET_RETURN_IF_ERROR(within("threads", absl::GetFlag(FLAGS_threads), 0, 256));
  return within("steps", absl::GetFlag(FLAGS_steps), 0, 1'000'000'000'000);
}

absl::StatusOr<std::string> TrainProgram() {
  std::error_code error;
  const std::filesystem::path own = std::filesystem::read_symlink("/proc/self/exe", error);
  const std::filesystem::path train = own.parent_path() / "craftfleet-train";
  if (!error && std::filesystem::exists(train, error)) return train.string();
  return absl::NotFoundError(absl::StrCat(train.string(), " is not there: it belongs beside this program"));
}

std::vector<std::string> TrainFlags() {
  int threads = absl::GetFlag(FLAGS_threads);
  if (threads == 0) threads = std::max(1, DefaultThreads() / absl::GetFlag(FLAGS_jobs));
  std::vector<std::string> flags = {absl::StrCat("--threads=", threads)};
  if (const std::string textures = absl::GetFlag(FLAGS_textures); !textures.empty()) {
    flags.push_back(absl::StrCat("--textures=", textures));
  }
  return flags;
}

absl::Status List(const std::vector<const Cell*>& cells, const SweepSettings& settings) {
  for (const Cell* cell : cells) {
    absl::PrintF("%-48s %9d steps", absl::StrCat(cell->experiment, "/", cell->name), cell->config.steps());
    if (!settings.logdir.empty()) {
      int done = 0;
      for (const SweepJob& job : PlanSweep({cell}, settings)) {
        CRAFTFLEET_ASSIGN_OR_RETURN(const RunState state, ReadRunState(job.folder, job.config.steps()));
        done += state.finished ? 1 : 0;
      }
      absl::PrintF("   %d of %d done", done, settings.seeds);
    }
    const bool shared = cell->folder != absl::StrCat(cell->experiment, "/", cell->name);
    absl::PrintF("%s\n", shared ? absl::StrCat("   as ", cell->folder) : "");
  }
  absl::PrintF("%d cells\n", cells.size());
  return absl::OkStatus();
}

absl::Status PrintCommands(const std::vector<SweepJob>& jobs) {
  for (const SweepJob& job : jobs) {
    CRAFTFLEET_ASSIGN_OR_RETURN(const RunState state, ReadRunState(job.folder, job.config.steps()));
    if (state.finished) continue;
    absl::PrintF("craftfleet train %s\n", absl::StrJoin(state.begun ? job.resume : job.start, " "));
  }
  return absl::OkStatus();
}

absl::Status Run(const std::vector<std::string>& arguments) {
  if (arguments.size() != 1) return absl::InvalidArgumentError("name one file with experiments; see --help");
  CRAFTFLEET_RETURN_IF_ERROR(CheckFlags());
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::vector<Experiment> experiments, LoadExperiments(arguments[0]));
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::vector<const Cell*> cells,
                              SelectCells(experiments, {absl::GetFlag(FLAGS_experiment), absl::GetFlag(FLAGS_cell)}));
  if (const std::string folder = absl::GetFlag(FLAGS_write_configs); !folder.empty()) {
    return WriteCellConfigs(cells, folder);
  }
  SweepSettings settings;
  settings.logdir = absl::GetFlag(FLAGS_logdir);
  settings.seeds = absl::GetFlag(FLAGS_seeds);
  settings.steps = absl::GetFlag(FLAGS_steps);
  settings.train_flags = TrainFlags();
  if (absl::GetFlag(FLAGS_list)) return List(cells, settings);
  if (settings.logdir.empty()) return absl::InvalidArgumentError("--logdir is missing: the folder for the runs");
  std::vector<SweepJob> jobs = PlanSweep(cells, settings);
  if (absl::GetFlag(FLAGS_dry_run)) return PrintCommands(jobs);

  Sweep::Options options;
  CRAFTFLEET_ASSIGN_OR_RETURN(options.program, TrainProgram());
  options.jobs = absl::GetFlag(FLAGS_jobs);
  RealClock clock;
  Sweep sweep(std::move(jobs), options, &std::cout, &clock);
  StopSignal signal([&sweep] { sweep.Stop(); });
  return sweep.Run();
}

}  // namespace
}  // namespace craftfleet

int main(int argc, char** argv) {
  const std::vector<std::string> arguments =
      craftfleet::ParseFlagsAndArguments(craftfleet::kProgram, craftfleet::kUsage, argc, argv);
  return craftfleet::ExitCode(craftfleet::kProgram, craftfleet::Run(arguments));
}
