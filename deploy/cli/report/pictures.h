// The report's pictures.

#ifndef CRAFTFLEET_DEPLOY_CLI_REPORT_PICTURES_H_
#define CRAFTFLEET_DEPLOY_CLI_REPORT_PICTURES_H_

#include <optional>
#include <string>
#include <vector>

#include <absl/types/span.h>

#include "deploy/cli/report/paper_figures.h"
#include "deploy/cli/report/results.h"

namespace craftfleet {

struct Picture {
  std::string name;   // of its file: "table1-curves.png"
  std::string title;  // its alternative text
  std::string png;
};

// Cells with runs, split into charts of at most seven. Experiments that vary one axis at a time have a chart per axis
// (none for an axis with only one such cell); those that vary two have one per choice of the first axis.
std::vector<std::vector<const CellResult*>> ChartParts(const ExperimentResult& experiment);

// Learning curves: the mean over complete seeds with one standard deviation shaded; unfinished runs are dashed.
// nullopt if no run has ten episodes.
std::optional<Picture> CurvePicture(const std::string& name, const std::string& title,
                                    absl::Span<const CellResult* const> cells);

// Success rate of each achievement; the cells have complete runs.
Picture AchievementPicture(const std::string& name, const std::string& title,
                           absl::Span<const CellResult* const> cells);

// Bars of our scores and the paper's, for experiments whose cells vary one axis; cells with neither are left out.
Picture ScorePicture(const ExperimentResult& experiment, const PaperFigures& paper);

// Training and evaluation scores of two axes against each other, ours and the paper's; for PAIRS the training scores
// of every pair. Maps without a run are not drawn.   nullopt if none has a run.
std::optional<Picture> HeatmapPicture(const ExperimentResult& experiment, const PaperFigures& paper);

// All pictures of an experiment with runs.
std::vector<Picture> ExperimentPictures(const ExperimentResult& experiment, const PaperFigures& paper);

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_CLI_REPORT_PICTURES_H_
