// The tables of the report in Markdown.

#ifndef CRAFTFLEET_DEPLOY_CLI_REPORT_MARKDOWN_H_
#define CRAFTFLEET_DEPLOY_CLI_REPORT_MARKDOWN_H_

#include <string>
#include <vector>

#include <absl/strings/string_view.h>
#include <absl/types/span.h>

#include "deploy/cli/report/paper_figures.h"
#include "deploy/cli/report/results.h"

namespace craftfleet {

// A table in Markdown; every row has as many cells as `header`.
std::string MarkdownTable(const std::vector<std::string>& header, const std::vector<std::vector<std::string>>& rows);

// A collapsible section with `text`; Markdown viewers show only its summary line at first.
std::string Folded(absl::string_view summary, absl::string_view text);

// The tables of one experiment: our values, and the paper's if it has them. A cell without a run shows "no run"; one
// with only unfinished runs shows their progress. An experiment with one axis has a row per choice; one with two axes
// has a row per choice of the first and a column per choice of the second. Rows without a run are folded.
std::string ExperimentTables(const ExperimentResult& experiment, const PaperFigures& paper);

// Success rates in percent: a row per achievement, a column per cell. The cells have complete runs.
std::string AchievementTable(absl::Span<const CellResult* const> cells);

// Published results of other players and agents, for scale.
std::string ScaleTable(const PaperFigures& paper);

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_CLI_REPORT_MARKDOWN_H_
