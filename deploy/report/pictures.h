// The report's pictures.

#ifndef CRAFTFLEET_DEPLOY_REPORT_PICTURES_H_
#define CRAFTFLEET_DEPLOY_REPORT_PICTURES_H_

#include <string>
#include <vector>

#include <absl/types/span.h>

#include "deploy/report/paper_figures.h"
#include "deploy/report/results.h"

namespace craftfleet {

struct Picture {
  std::string name;   // of its file: "table1-curves.png"
  std::string title;  // for those who can't see it
  std::string png;
};

// Cells with runs in parts that are told apart in one chart, at most seven each: those of one axis where one is varied
// at a time (an axis with a single such cell has none), of one choice of the first axis where there are two.
std::vector<std::vector<const CellResult*>> ChartParts(const ExperimentResult& experiment);

// Learning curves: mean over complete seeds, shaded one standard deviation to both sides; unfinished runs dashed.
Picture CurvePicture(const std::string& name, const std::string& title, absl::Span<const CellResult* const> cells);

// Success rate of each achievement; the cells have complete runs.
Picture AchievementPicture(const std::string& name, const std::string& title,
                           absl::Span<const CellResult* const> cells);

// Scores as bars beside the paper's, for experiments whose cells vary one axis; those with runs or figures.
Picture ScorePicture(const ExperimentResult& experiment, const PaperFigures& paper);

// Training and evaluation scores of two axes against each other, ours and the paper's; for PAIRS the training scores
// of every pair.
Picture HeatmapPicture(const ExperimentResult& experiment, const PaperFigures& paper);

// All that belong to an experiment with runs.
std::vector<Picture> ExperimentPictures(const ExperimentResult& experiment, const PaperFigures& paper);

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_REPORT_PICTURES_H_
