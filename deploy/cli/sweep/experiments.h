// The experiments of a file: the configurations behind each table and figure.

#ifndef CRAFTFLEET_DEPLOY_CLI_SWEEP_EXPERIMENTS_H_
#define CRAFTFLEET_DEPLOY_CLI_SWEEP_EXPERIMENTS_H_

#include <string>
#include <vector>

#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>

#include "craftfleet/v1/experiment.pb.h"

namespace craftfleet {

// An axis as an experiment uses it.
struct ExperimentAxis {
  std::string name;                 // "agent"
  std::vector<v1::Choice> choices;  // labels filled in
};

// One configuration of an experiment.
struct Cell {
  std::string experiment;      // "ood_app"
  std::string name;            // its choices joined by slashes: "94-2-2-2/ppo_cnn"
  std::vector<int> axes;       // the axes that it varies, ascending
  std::vector<int> choices;    // index within each of those
  std::string config_text;     // differences from the defaults, text format; without the seed, which the sweep sets
  v1::RunConfig config;        // complete
  std::string texture_digest;  // of the textures of its runs; "": those that come with the programs
  // Folder of its runs below that of the sweep. It belongs to the first cell of the file with the same configuration,
  // so that tables that share a cell share its runs.
  std::string folder;  // "ood_app/94-2-2-2/ppo_cnn"
};

struct Experiment {
  std::string name;
  std::string title;
  v1::Experiment::Combine combine = v1::Experiment::PRODUCT;
  std::vector<ExperimentAxis> axes;
  std::vector<int64_t> milestones;  // environment steps, ascending
  std::vector<Cell> cells;          // the last axis varies fastest
};

// Every cell is a configuration that ResolveRunConfig accepts; names are unique in their experiment.
//   InvalidArgument: names the file, and the line or the experiment and cell.
absl::StatusOr<std::vector<Experiment>> ParseExperiments(absl::string_view text, absl::string_view filename);

// The same, from a file. Errors also as ReadFile.
absl::StatusOr<std::vector<Experiment>> LoadExperiments(const std::string& path);

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_CLI_SWEEP_EXPERIMENTS_H_
