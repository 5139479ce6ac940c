// What a sweep is to run: one job for each configuration and seed.

#ifndef CRAFTFLEET_DEPLOY_EXPERIMENT_SWEEP_PLAN_H_
#define CRAFTFLEET_DEPLOY_EXPERIMENT_SWEEP_PLAN_H_

#include <cstdint>
#include <string>
#include <vector>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/types/span.h>

#include "deploy/experiment/experiments.h"

namespace craftfleet {

// Which cells; both empty: all.
struct CellFilter {
  std::vector<std::string> experiments;  // names
  std::vector<std::string> cells;        // names, or their first parts: "94-2-2-2" has all of "94-2-2-2/..."
};

// In the file's order.
//   InvalidArgument: names what the file does not have, and lists what it has.
absl::StatusOr<std::vector<const Cell*>> SelectCells(absl::Span<const Experiment> experiments,
                                                     const CellFilter& filter);

// What a sweep does alike to all of its runs.
struct SweepSettings {
  std::string logdir;                    // the sweep's; runs lie in <logdir>/<cell's folder>/seed<k>
  int seeds = 10;                        // 1..seeds
  int64_t steps = 0;                     // environment steps of each run; 0: as its cell says
  std::vector<std::string> train_flags;  // handed to each `craftfleet train`
};

struct SweepJob {
  std::string name;                 // "table1/ppo_cnn/seed1"
  std::string folder;               // of the run
  std::string config_path;          // the file that the run is started with
  std::string config_text;          // what belongs into it
  v1::RunConfig config;             // of the run, complete but for the seed
  std::vector<std::string> start;   // arguments of `craftfleet train` for a new run
  std::vector<std::string> resume;  // the same to go on with it
};

// Seed 1 of every cell, then seed 2, ...; cells that share a folder are run once.
std::vector<SweepJob> PlanSweep(absl::Span<const Cell* const> cells, const SweepSettings& settings);

// Makes the run's folder, and writes the config file that it is started with unless it is there. The jobs of a cell
// share that file: not from two threads or processes at once while it is missing.
absl::Status PrepareFolder(const SweepJob& job);

// What the cell's config file says, with a first line about where it comes from.
std::string CellConfigFile(const Cell& cell);

// Writes <folder>/<experiment>/<cell>.txt for each cell.
absl::Status WriteCellConfigs(absl::Span<const Cell* const> cells, const std::string& folder);

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_EXPERIMENT_SWEEP_PLAN_H_
