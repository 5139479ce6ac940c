#include "deploy/report/report.h"

#include <algorithm>
#include <utility>
#include <vector>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>

#include "common/files.h"
#include "common/status_macros.h"
#include "deploy/report/csv.h"
#include "deploy/report/markdown.h"
#include "deploy/report/pictures.h"
#include "deploy/report/results.h"
#include "learner/run/progress.h"

namespace craftfleet {
namespace {

constexpr char kReading[] = R"(How to read it:
- Scores are Crafter's: exp(mean of ln(1 + success rate in percent)) - 1 over the 22 achievements. The training score is over
  all training episodes of a run; evaluation scores are over all evaluation episodes during training, with drawn actions, and
  argmax with the likeliest ones; the paper does not say which of the two its evaluation rows are.
- Numbers are means ± sample standard deviations (n - 1) over seeds; one seed has no deviation. A run that has not reached its
  steps is named and not averaged. "no run": there is none.
- Runs belong to a cell by their whole configuration, wherever they lie; cells of one configuration share runs.
- The CSV files beside this have all digits.

)";

std::string RunsTable(absl::Span<const RunRecord> runs, const std::map<std::string, std::string>& cells) {
  std::vector<std::vector<std::string>> rows;
  for (const RunRecord& run : runs) {
    const auto found = cells.find(run.identity);
    const bool any = run.training.episodes > 0;
    rows.push_back({run.folder, found == cells.end() ? "-" : found->second, absl::StrCat(run.config.seed()),
                    absl::StrCat(WithCommas(run.steps), " of ", WithCommas(run.config.steps())),
                    run.complete ? "yes" : "no", absl::StrCat(run.training.episodes),
                    any ? absl::StrFormat("%.2f", run.training.score) : "-",
                    any ? absl::StrFormat("%.2f", run.training.recent_reward) : "-",
                    any ? absl::StrCat(run.training.unlocked, "/", kNumAchievements) : "-"});
  }
  return MarkdownTable(
      {"folder", "cells", "seed", "steps", "complete", "episodes", "training score", "reward, last 100", "unlocked"},
      rows);
}

std::string Heading(absl::Span<const RunRecord> runs, absl::Span<const ExperimentResult> results, int complete) {
  int cells = 0;
  int filled = 0;
  for (const ExperimentResult& result : results) {
    cells += static_cast<int>(result.cells.size());
    filled += static_cast<int>(std::count_if(result.cells.begin(), result.cells.end(),
                                             [](const CellResult& cell) { return cell.has_complete(); }));
  }
  return absl::StrFormat(
      "# Report\n\n%d runs, %d of them complete; %d of %d cells have a complete run. Made by `craftfleet report`.\n\n",
      runs.size(), complete, filled, cells);
}

// The experiment's part of report.md; its pictures and its CSV go to `files`.
std::string Section(const ExperimentResult& result, const PaperFigures& paper,
                    std::map<std::string, std::string>* files) {
  std::string text = absl::StrCat("## ", result.title, "\n\n", ExperimentTables(result, paper));
  const std::string csv = absl::StrCat(result.name, ".csv");
  (*files)[csv] = ExperimentCsv(result, paper);
  if (!result.has_runs()) return text;
  for (Picture& picture : ExperimentPictures(result, paper)) {
    absl::StrAppend(&text, "![", picture.title, "](", picture.name, ")\n\n");
    (*files)[picture.name] = std::move(picture.png);
  }
  if (result.combine == v1::Experiment::PAIRS) return text;
  for (std::vector<const CellResult*>& part : ChartParts(result)) {
    part.erase(std::remove_if(part.begin(), part.end(), [](const CellResult* cell) { return !cell->has_complete(); }),
               part.end());
    if (!part.empty()) text += AchievementTable(part);
  }
  return text;
}

}  // namespace

Report MakeReport(absl::Span<const Experiment> experiments, const PaperFigures& paper,
                  absl::Span<const RunRecord> runs) {
  Report report;
  const std::map<std::string, RunGroup> groups = GroupRuns(runs);
  const std::vector<ExperimentResult> results = MatchRuns(experiments, groups);
  const std::map<std::string, std::string> cells = CellNames(experiments);
  report.complete =
      static_cast<int>(std::count_if(runs.begin(), runs.end(), [](const RunRecord& run) { return run.complete; }));
  std::string text = absl::StrCat(Heading(runs, results, report.complete), kReading);
  for (const ExperimentResult& result : results) text += Section(result, paper, &report.files);
  if (!paper.all().empty()) absl::StrAppend(&text, "## Others, for scale\n\n", ScaleTable(paper));
  absl::StrAppend(&text, "## Runs\n\n", RunsTable(runs, cells));
  report.files["report.md"] = std::move(text);
  report.files["runs.csv"] = RunsCsv(runs, cells);
  report.files["achievements.csv"] = AchievementsCsv(results);
  report.files["curves.csv"] = CurvesCsv(results);
  return report;
}

absl::Status WriteReport(const Report& report, const std::string& folder) {
  CRAFTFLEET_RETURN_IF_ERROR(CreateFolders(folder));
  for (const auto& [name, content] : report.files) {
    CRAFTFLEET_RETURN_IF_ERROR(ReplaceFile(JoinPath(folder, name), content));
  }
  return absl::OkStatus();
}

}  // namespace craftfleet
