#include "deploy/cli/sweep/sweep_plan.h"

#include <algorithm>
#include <set>

#include <absl/strings/match.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_join.h>

#include "common/base/status_macros.h"
#include "common/base/status_prefix.h"
#include "common/io/files.h"

namespace craftfleet {
namespace {

bool Contains(const std::vector<std::string>& items, const std::string& item) {
  return std::find(items.begin(), items.end(), item) != items.end();
}

bool IsOrLiesIn(absl::string_view cell, absl::string_view wanted) {
  return cell == wanted || absl::StartsWith(cell, absl::StrCat(wanted, "/"));
}

SweepJob MakeJob(const Cell& cell, int seed, const SweepSettings& settings) {
  SweepJob job;
  const std::string folder = JoinPath(settings.logdir, cell.folder);
  job.name = absl::StrCat(cell.folder, "/seed", seed);
  job.folder = JoinPath(folder, absl::StrCat("seed", seed));
  job.config_path = JoinPath(folder, "cell.txt");
  job.config_text = CellConfigFile(cell);
  job.config = cell.config;
  if (settings.steps > 0) job.config.set_steps(settings.steps);
  const std::string logdir = absl::StrCat("--logdir=", job.folder);
  const std::string steps = absl::StrCat("--steps=", job.config.steps());
  job.start = {absl::StrCat("--config=", job.config_path), absl::StrCat("--seed=", seed), steps, logdir};
  job.resume = {"--resume", steps, logdir};
  for (std::vector<std::string>* arguments : {&job.start, &job.resume}) {
    arguments->insert(arguments->end(), settings.train_flags.begin(), settings.train_flags.end());
  }
  return job;
}

}  // namespace

absl::StatusOr<std::vector<const Cell*>> SelectCells(absl::Span<const Experiment> experiments,
                                                     const CellFilter& filter) {
  std::vector<const Cell*> selected;
  std::vector<std::string> names;
  std::set<std::string> found;
  for (const Experiment& experiment : experiments) {
    names.push_back(experiment.name);
    if (!filter.experiments.empty() && !Contains(filter.experiments, experiment.name)) continue;
    for (const Cell& cell : experiment.cells) {
      const auto wanted = std::find_if(filter.cells.begin(), filter.cells.end(),
                                       [&](const std::string& name) { return IsOrLiesIn(cell.name, name); });
      if (!filter.cells.empty() && wanted == filter.cells.end()) continue;
      if (!filter.cells.empty()) found.insert(*wanted);
      selected.push_back(&cell);
    }
  }
  for (const std::string& name : filter.experiments) {
    if (Contains(names, name)) continue;
    return absl::InvalidArgumentError(
        absl::StrCat("--experiment=", name, ", want one of ", absl::StrJoin(names, ", ")));
  }
  for (const std::string& name : filter.cells) {
    if (found.count(name) > 0) continue;
    return absl::InvalidArgumentError(absl::StrCat("--cell=", name, ", want a cell that --list names"));
  }
  return selected;
}

absl::StatusOr<std::vector<const Cell*>> CellsWithTextures(absl::Span<const Cell* const> cells,
                                                           absl::string_view digest) {
  std::vector<const Cell*> drawn;
  for (const Cell* cell : cells) {
    if (cell->texture_digest.empty() || cell->texture_digest == digest) drawn.push_back(cell);
  }
  if (!drawn.empty() || cells.empty()) return drawn;
  return absl::FailedPreconditionError(absl::StrCat("cell ", cells[0]->experiment, "/", cells[0]->name,
                                                    " wants textures ", cells[0]->texture_digest, ", not ", digest,
                                                    ": give their folder with --textures"));
}

std::vector<SweepJob> PlanSweep(absl::Span<const Cell* const> cells, const SweepSettings& settings) {
  std::vector<const Cell*> distinct;
  std::set<std::string> folders;
  for (const Cell* cell : cells) {
    if (folders.insert(cell->folder).second) distinct.push_back(cell);
  }
  std::vector<SweepJob> jobs;
  jobs.reserve(distinct.size() * settings.seeds);
  for (int seed = 1; seed <= settings.seeds; ++seed) {
    for (const Cell* cell : distinct) jobs.push_back(MakeJob(*cell, seed, settings));
  }
  return jobs;
}

absl::Status PrepareFolder(const SweepJob& job) {
  CRAFTFLEET_RETURN_IF_ERROR(WithPrefix("--logdir", CreateFolders(job.folder)));
  const absl::StatusOr<std::string> there = ReadFile(job.config_path);
  return there.ok() && *there == job.config_text ? absl::OkStatus() : ReplaceFile(job.config_path, job.config_text);
}

std::string CellConfigFile(const Cell& cell) {
  return absl::StrCat("# ", cell.experiment, ", ", cell.name, "; values that are not given have their defaults.\n",
                      cell.config_text);
}

absl::Status WriteCellConfigs(absl::Span<const Cell* const> cells, const std::string& folder) {
  for (const Cell* cell : cells) {
    const std::string path = JoinPath(folder, absl::StrCat(cell->experiment, "/", cell->name, ".txt"));
    CRAFTFLEET_RETURN_IF_ERROR(WithPrefix("--write_configs", CreateFolders(path.substr(0, path.rfind('/')))));
    CRAFTFLEET_RETURN_IF_ERROR(ReplaceFile(path, CellConfigFile(*cell)));
  }
  return absl::OkStatus();
}

}  // namespace craftfleet
