// Assigns runs to the cells of experiments.

#ifndef CRAFTFLEET_DEPLOY_CLI_REPORT_RESULTS_H_
#define CRAFTFLEET_DEPLOY_CLI_REPORT_RESULTS_H_

#include <map>
#include <string>
#include <vector>

#include <absl/types/span.h>

#include "deploy/cli/report/run_group.h"
#include "deploy/cli/sweep/experiments.h"

namespace craftfleet {

struct CellResult {
  std::string name;       // the cell's name; for runs that belong to no cell, their folder (RunName)
  std::string label;      // for tables and charts
  std::vector<int> axes;  // as in Cell
  std::vector<int> choices;
  const RunGroup* group = nullptr;  // without runs: nullptr

  bool has_complete() const { return group != nullptr && !group->complete.empty(); }
};

struct ExperimentResult {
  std::string name;
  std::string title;
  v1::Experiment::Combine combine = v1::Experiment::EACH;
  std::vector<ExperimentAxis> axes;
  std::vector<int64_t> milestones;
  std::vector<CellResult> cells;

  bool has_runs() const;
  // Runs that fit no cell: not an experiment of the file.
  bool is_own() const { return name == kOwnRuns; }

  static constexpr char kOwnRuns[] = "other";  // also the name of its CSV file
};

// The first result contains the runs that belong to no cell: a single axis, with a cell for each configuration, sorted
// by folder. A result for each experiment follows. A group belongs to every cell of its configuration. `groups` must
// outlive the result.
std::vector<ExperimentResult> MatchRuns(absl::Span<const Experiment> experiments,
                                        const std::map<std::string, RunGroup>& groups);

// The cells of each identity: "table1/ppo_cnn ood_app/ordinary/ppo_cnn".
std::map<std::string, std::string> CellNames(absl::Span<const Experiment> experiments);

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_CLI_REPORT_RESULTS_H_
