// Runs put into the cells of experiments.

#ifndef CRAFTFLEET_DEPLOY_REPORT_RESULTS_H_
#define CRAFTFLEET_DEPLOY_REPORT_RESULTS_H_

#include <map>
#include <string>
#include <vector>

#include <absl/types/span.h>

#include "deploy/experiment/experiments.h"
#include "deploy/report/run_group.h"

namespace craftfleet {

struct CellResult {
  std::string name;       // the cell's, or for runs of no cell the folder that they lie in
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
};

// One for each experiment, and where runs fit no cell a last one of these, named "other", with a single axis. A group
// stands in every cell of its configuration. `groups` must outlive the result.
std::vector<ExperimentResult> MatchRuns(absl::Span<const Experiment> experiments,
                                        const std::map<std::string, RunGroup>& groups);

// By identity the cells of that configuration: "table1/ppo_cnn ood_app/ordinary/ppo_cnn".
std::map<std::string, std::string> CellNames(absl::Span<const Experiment> experiments);

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_REPORT_RESULTS_H_
