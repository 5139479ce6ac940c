// craftfleet sweep: runs experiments.

#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <iostream>
#include <string>
#include <system_error>
#include <vector>

#include <absl/flags/flag.h>
#include <absl/strings/match.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/strings/str_join.h>
#include <absl/strings/str_split.h>

#include "common/base/status_macros.h"
#include "common/io/files.h"
#include "common/io/paths.h"
#include "common/io/texture_digest.h"
#include "common/process/cpu_quota.h"
#include "common/process/flag_check.h"
#include "common/process/flag_values.h"
#include "common/process/program.h"
#include "common/telemetry/log.h"
#include "deploy/cli/sweep/experiments.h"
#include "deploy/cli/sweep/run_state.h"
#include "deploy/cli/sweep/slurm_array.h"
#include "deploy/cli/sweep/sweep.h"
#include "deploy/cli/sweep/sweep_plan.h"

ABSL_FLAG(std::vector<std::string>, experiment, {}, "experiments of the file to run, joined by commas [all]");
ABSL_FLAG(std::vector<std::string>, cell, {},
          "cells to run, joined by commas\n"
          "such as ppo_cnn, 94-2-2-2/ppo_cnn, or 94-2-2-2 for all cells below it\n"
          "[all]");
ABSL_FLAG(int32_t, seeds, 10, "runs of each cell, with the seeds 1, 2, ...; 1..1000");
ABSL_FLAG(int32_t, jobs, 1, "runs at a time, 1..1000");
ABSL_FLAG(std::vector<std::string>, run, {}, "only these runs, joined by commas: table1/ppo_cnn/seed1 [all]");
ABSL_FLAG(std::string, executor, "local",
          "where to run: local (processes on this machine) or slurm (one array job)\n"
          "tasks that Slurm preempts are requeued and resume");
ABSL_FLAG(std::string, slurm_flags, "",
          "with --executor=slurm: flags for sbatch, such as \"--partition=gpu --mem=8G --time=2-0\"");
ABSL_FLAG(craftfleet::Count, steps, {0},
          "environment steps of each run, for a trial: 100000 or 100k; 0: those of the experiment");
ABSL_FLAG(std::string, logdir, "", "folder of the runs: LOGDIR/EXPERIMENT/CELL/seed1, ... (required to run)");
ABSL_FLAG(bool, list, false, "only list the cells; with --logdir also the number of their finished runs");
ABSL_FLAG(bool, dry_run, false, "only print the commands that would be run, or with --executor=slurm the script");
ABSL_FLAG(std::string, write_configs, "", "only write each cell's configuration to DIR/EXPERIMENT/CELL.txt");
ABSL_FLAG(int32_t, threads, 0,
          "threads of each run; 0: the CPU quota divided among --jobs\n"
          "with --executor=slurm 0 means 1");
ABSL_FLAG(std::string, textures, "",
          "textures of all runs, as for craftfleet train [the ones that come with this program]");

namespace craftfleet {
namespace {

constexpr char kProgram[] = "craftfleet sweep";
constexpr char kUsage[] =
    R"(craftfleet sweep FILE runs the experiments of a file: every cell with several seeds, each with `craftfleet train`. After a
stop or a crash, the same command continues: it skips complete runs and resumes the others. A run that fails is reported and
does not stop the others. The folder of each run has its output in log.txt.

  craftfleet sweep deploy/experiments/paper.txt --list
  craftfleet sweep deploy/experiments/paper.txt --experiment=table1 --cell=ppo_cnn --seeds=3 --jobs=2 --logdir=runs/paper
  craftfleet sweep deploy/experiments/paper.txt --executor=slurm --jobs=100 --logdir=/shared/runs/paper
  craftfleet report runs/paper --out=report

Ctrl-C, SIGTERM or closing the terminal stops it and its runs, each with a checkpoint. If its output is closed
(craftfleet sweep ... | head), it continues silently.)";

absl::Status CheckFlags() {
  CRAFTFLEET_RETURN_IF_ERROR(CheckFlagRange("seeds", absl::GetFlag(FLAGS_seeds), 1, 1000));
  CRAFTFLEET_RETURN_IF_ERROR(CheckFlagRange("jobs", absl::GetFlag(FLAGS_jobs), 1, 1000));
  CRAFTFLEET_RETURN_IF_ERROR(CheckFlagRange("threads", absl::GetFlag(FLAGS_threads), 0, 256));
  if (const std::string executor = absl::GetFlag(FLAGS_executor); executor != "local" && executor != "slurm") {
    return InvalidFlag("executor", executor, "local or slurm");
  }
  return CheckFlagRange<int64_t>("steps", absl::GetFlag(FLAGS_steps).value, 0, 1'000'000'000'000);
}

std::filesystem::path OwnPath() {
  std::error_code error;
  return std::filesystem::read_symlink("/proc/self/exe", error);
}

absl::StatusOr<std::string> TrainProgram() {
  const std::filesystem::path train = OwnPath().parent_path() / "craftfleet-train";
  std::error_code error;
  if (std::filesystem::exists(train, error)) return train.string();
  return absl::NotFoundError(
      absl::StrCat(train.string(), " is missing: it must be in the same folder as this program"));
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

// What a run has; names a run that cannot be read in a warning, and takes it for one that is not complete.
RunState StateOf(const SweepJob& job) {
  const absl::StatusOr<RunState> state = ReadRunState(job.folder, job.config.steps());
  if (!state.ok()) LogWarning("%s cannot be read: %s", job.name, state.status().message());
  return state.value_or(RunState());
}

absl::Status List(const std::vector<const Cell*>& cells, const SweepSettings& settings) {
  for (const Cell* cell : cells) {
    absl::PrintF("%-48s %9d steps", absl::StrCat(cell->experiment, "/", cell->name), cell->config.steps());
    if (!settings.logdir.empty()) {
      int done = 0;
      for (const SweepJob& job : PlanSweep({cell}, settings)) {
        done += StateOf(job).finished ? 1 : 0;
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
    const RunState state = StateOf(job);
    if (state.finished) continue;
    absl::PrintF("craftfleet train %s\n", absl::StrJoin(state.begun ? job.resume : job.start, " "));
  }
  return absl::OkStatus();
}

// Removes from `jobs` those that --run does not name.
absl::Status KeepNamedRuns(std::vector<SweepJob>* jobs) {
  const std::vector<std::string> names = absl::GetFlag(FLAGS_run);
  if (names.empty()) return absl::OkStatus();
  std::vector<SweepJob> kept;
  for (const std::string& name : names) {
    const auto job =
        std::find_if(jobs->begin(), jobs->end(), [&](const SweepJob& other) { return other.name == name; });
    if (job == jobs->end()) {
      return absl::InvalidArgumentError(
          absl::StrCat("--run: no run \"", name, "\", want one like ", jobs->front().name));
    }
    kept.push_back(*job);
  }
  *jobs = std::move(kept);
  return absl::OkStatus();
}

// The array job for the runs that are not complete.
absl::StatusOr<SlurmArray> MakeSlurmArray(const std::string& file, const std::string& logdir,
                                          const std::vector<SweepJob>& jobs) {
  SlurmArray array;
  array.logs = JoinPath(logdir, "slurm");
  array.at_a_time = absl::GetFlag(FLAGS_jobs);
  array.threads = std::max(1, absl::GetFlag(FLAGS_threads));
  array.command = {OwnPath().string(), std::filesystem::absolute(file).string(), absl::StrCat("--logdir=", logdir),
                   absl::StrCat("--seeds=", absl::GetFlag(FLAGS_seeds)),
                   absl::StrCat("--steps=", absl::GetFlag(FLAGS_steps).value)};
  if (const std::string textures = absl::GetFlag(FLAGS_textures); !textures.empty()) {
    array.command.push_back(absl::StrCat("--textures=", std::filesystem::absolute(textures).string()));
  }
  for (const SweepJob& job : jobs) {
    if (!StateOf(job).finished) array.runs.push_back(job.name);
  }
  return array;
}

// Replaces this process by sbatch. Returns only if that fails.
absl::Status Submit(const SlurmArray& array) {
  const std::string path = JoinPath(array.logs, "sweep.sbatch");
  CRAFTFLEET_RETURN_IF_ERROR(CreateFolders(array.logs));
  CRAFTFLEET_RETURN_IF_ERROR(ReplaceFile(path, SlurmArrayScript(array)));
  std::vector<std::string> words = {"sbatch"};
  for (const absl::string_view flag : absl::StrSplit(absl::GetFlag(FLAGS_slurm_flags), ' ', absl::SkipEmpty())) {
    words.emplace_back(flag);
  }
  words.push_back(path);
  std::vector<char*> pointers;
  pointers.reserve(words.size() + 1);
  for (std::string& word : words) pointers.push_back(word.data());
  pointers.push_back(nullptr);
  absl::PrintF("unfinished runs: %d; logs will be in %s\n", array.runs.size(), array.logs);
  std::fflush(stdout);
  execvp("sbatch", pointers.data());
  const absl::Status error = FileError(errno, "cannot start", "sbatch");
  return absl::Status(error.code(), absl::StrCat(error.message(), "; submit ", path, " on a machine with Slurm"));
}

absl::Status RunOnSlurm(const std::string& file, const std::string& logdir, const std::vector<SweepJob>& jobs) {
  const std::string absolute = std::filesystem::absolute(logdir).string();
  // Slurm 22.05 replaces these in names of an array's logs, however they are written.
  if (absl::StrContains(absolute, "%A") || absl::StrContains(absolute, "%a")) {
    return InvalidFlag("logdir", absolute, "a folder without %A and %a, which Slurm replaces by numbers of the job");
  }
  CRAFTFLEET_ASSIGN_OR_RETURN(const SlurmArray array, MakeSlurmArray(file, absolute, jobs));
  if (array.runs.empty()) {
    absl::PrintF("all runs are done: %d\n", jobs.size());
    return absl::OkStatus();
  }
  if (absl::GetFlag(FLAGS_dry_run)) {
    absl::PrintF("%s", SlurmArrayScript(array));
    return absl::OkStatus();
  }
  for (const SweepJob& job : jobs) CRAFTFLEET_RETURN_IF_ERROR(PrepareFolder(job));
  return Submit(array);
}

absl::Status Run(const std::vector<std::string>& arguments) {
  if (arguments.size() != 1) {
    return absl::InvalidArgumentError(
        "name one file with experiments, such as deploy/experiments/paper.txt; see --help");
  }
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
  settings.steps = absl::GetFlag(FLAGS_steps).value;
  settings.train_flags = TrainFlags();
  if (absl::GetFlag(FLAGS_list)) return List(cells, settings);
  if (settings.logdir.empty()) return absl::InvalidArgumentError("--logdir is missing: the folder for the runs");
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string textures, TextureDir(absl::GetFlag(FLAGS_textures)));
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string digest, TextureDigest(textures));
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::vector<const Cell*> drawn, CellsWithTextures(cells, digest));
  if (drawn.size() < cells.size()) {
    std::cerr << kProgram << ": " << cells.size() - drawn.size()
              << " cells want other textures and are left out; --textures selects the textures\n";
  }
  std::vector<SweepJob> jobs = PlanSweep(drawn, settings);
  CRAFTFLEET_RETURN_IF_ERROR(KeepNamedRuns(&jobs));
  if (absl::GetFlag(FLAGS_executor) == "slurm") return RunOnSlurm(arguments[0], settings.logdir, jobs);
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
  craftfleet::OutliveReaders();
  const std::vector<std::string> arguments = craftfleet::ParseFlagsAndArguments(
      craftfleet::kProgram, craftfleet::kUsage, argc, argv,
      {"logdir", "experiment", "cell", "seeds", "jobs", "steps", "list", "dry_run", "executor", "threads"});
  const absl::Status status = craftfleet::Run(arguments);
  const int exit_code = craftfleet::ExitCode(craftfleet::kProgram, status);
  return absl::IsCancelled(status) ? craftfleet::kSweepStopped : exit_code;
}
