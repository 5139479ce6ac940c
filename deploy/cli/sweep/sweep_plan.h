// The jobs of a sweep: one for each configuration and seed.

#ifndef CRAFTFLEET_DEPLOY_CLI_SWEEP_SWEEP_PLAN_H_
#define CRAFTFLEET_DEPLOY_CLI_SWEEP_SWEEP_PLAN_H_

#include <cstdint>
#include <string>
#include <vector>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>
#include <absl/types/span.h>

#include "deploy/cli/sweep/experiments.h"

namespace craftfleet {

// Selects cells; both empty: all.
struct CellFilter {
  std::vector<std::string> experiments;  // names
  std::vector<std::string> cells;        // names, or their first parts: "94-2-2-2" selects all of "94-2-2-2/..."
};

// In the file's order.
//   InvalidArgument: the file has no such name; lists the existing ones.
absl::StatusOr<std::vector<const Cell*>> SelectCells(absl::Span<const Experiment> experiments,
                                                     const CellFilter& filter);

// Those of `cells` whose runs are drawn with the textures of `digest`: cells without a digest of their own take any.
//   FailedPrecondition: there are none; names a cell and the textures that it wants.
absl::StatusOr<std::vector<const Cell*>> CellsWithTextures(absl::Span<const Cell* const> cells,
                                                           absl::string_view digest);

// The settings that all runs of a sweep share.
struct SweepSettings {
  std::string logdir;                    // the sweep's; a run is in <logdir>/<cell's folder>/seed<k>
  int seeds = 10;                        // 1..seeds
  int64_t steps = 0;                     // environment steps of each run; 0: those of its cell
  std::vector<std::string> train_flags;  // passed to each `craftfleet train`
};

struct SweepJob {
  std::string name;                 // "table1/ppo_cnn/seed1"
  std::string folder;               // of the run
  std::string config_path;          // the file that the run is started with
  std::string config_text;          // its contents
  v1::RunConfig config;             // of the run, complete except for the seed
  std::vector<std::string> start;   // arguments of `craftfleet train` for a new run
  std::vector<std::string> resume;  // the same, to resume it
};

// Seed 1 of every cell, then seed 2, ...; cells that share a folder are run once.
std::vector<SweepJob> PlanSweep(absl::Span<const Cell* const> cells, const SweepSettings& settings);

// Creates the run's folder, and its config file if that does not exist. The jobs of a cell share the file: while it is
// missing, only one thread or process may call this.
absl::Status PrepareFolder(const SweepJob& job);

// The contents of the cell's config file; its first line is a comment that names the cell.
std::string CellConfigFile(const Cell& cell);

// Writes <folder>/<experiment>/<cell>.txt for each cell.
absl::Status WriteCellConfigs(absl::Span<const Cell* const> cells, const std::string& folder);

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_CLI_SWEEP_SWEEP_PLAN_H_
