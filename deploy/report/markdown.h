// The report's tables for people to read.

#ifndef CRAFTFLEET_DEPLOY_REPORT_MARKDOWN_H_
#define CRAFTFLEET_DEPLOY_REPORT_MARKDOWN_H_

#include <string>
#include <vector>

#include <absl/types/span.h>

#include "deploy/report/paper_figures.h"
#include "deploy/report/results.h"

namespace craftfleet {

// A table in Markdown; every row has as many cells as `header`.
std::string MarkdownTable(const std::vector<std::string>& header, const std::vector<std::vector<std::string>>& rows);

// The tables of one experiment: ours, beside the paper's figures where it has them. A cell with no run says "no run";
// one whose runs are all under way says how far they are. Experiments of one axis have a row per choice, of two axes a
// row per choice of the first and a column per choice of the second.
std::string ExperimentTables(const ExperimentResult& experiment, const PaperFigures& paper);

// Success rates, percent, a row per achievement and a column per cell; the cells have complete runs.
std::string AchievementTable(absl::Span<const CellResult* const> cells);

// What the paper says of others, for scale.
std::string ScaleTable(const PaperFigures& paper);

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_REPORT_MARKDOWN_H_
