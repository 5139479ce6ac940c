#include "deploy/cli/report/report.h"

#include <algorithm>
#include <utility>
#include <vector>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/strings/str_join.h>
#include <absl/strings/str_split.h>

#include "common/base/numbers.h"
#include "deploy/cli/report/csv.h"
#include "deploy/cli/report/markdown.h"
#include "deploy/cli/report/pictures.h"
#include "deploy/cli/report/results.h"

namespace craftfleet {
namespace {

constexpr size_t kNamedCells = 2;  // of a run, in the list of runs

constexpr char kReading[] = R"(How to read it:
- Scores are Crafter scores: exp(mean of ln(1 + success rate in percent)) - 1 over the 22 achievements. The training score
  covers all training episodes of a run. Evaluation scores cover all evaluation episodes during training, with sampled actions
  or with the most likely ones (argmax). The paper does not say which of the two its evaluation rows use.
- Numbers are means ± sample standard deviations (n - 1) over seeds; a single seed has no deviation. Unfinished runs are listed
  but not averaged. "no run" marks a cell without a run.
- A run belongs to a cell if its whole configuration matches, wherever its folder is. Cells with the same configuration share runs.
- The CSV files in this folder have all digits.

)";

// "table1/ppo_cnn, ood_app/ordinary/ppo_cnn and 18 more"
std::string CellsText(const std::string& cells) {
  std::vector<std::string> names = absl::StrSplit(cells, ' ');
  if (names.size() <= kNamedCells) return absl::StrJoin(names, ", ");
  const size_t more = names.size() - kNamedCells;
  names.resize(kNamedCells);
  return absl::StrCat(absl::StrJoin(names, ", "), " and ", more, " more");
}

std::string RunsTable(absl::Span<const RunRecord> runs, const std::map<std::string, std::string>& cells) {
  std::vector<std::vector<std::string>> rows;
  for (const RunRecord& run : runs) {
    const auto found = cells.find(run.identity);
    const bool any = run.training.episodes > 0;
    rows.push_back({run.folder, found == cells.end() ? "-" : CellsText(found->second), absl::StrCat(run.config.seed()),
                    StepsText(run), run.complete ? "yes" : "no", absl::StrCat(run.training.episodes),
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
    if (result.is_own()) continue;
    cells += static_cast<int>(result.cells.size());
    filled += static_cast<int>(std::count_if(result.cells.begin(), result.cells.end(),
                                             [](const CellResult& cell) { return cell.has_complete(); }));
  }
  return absl::StrFormat(
      "# Report\n\n%s, %d of them complete; %d of %d cells have a complete run. Made by `craftfleet report`.\n\n",
      Counted(static_cast<int64_t>(runs.size()), "run"), complete, filled, cells);
}

// The part of report.md about an experiment that has runs; adds its pictures to `files`.
std::string Section(const ExperimentResult& result, const PaperFigures& paper,
                    std::map<std::string, std::string>* files) {
  std::string text = absl::StrCat("## ", result.title, "\n\n", ExperimentTables(result, paper));
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

// The tables of experiments that have no run.
std::string EmptyExperiments(absl::Span<const ExperimentResult> results, const PaperFigures& paper) {
  std::string text;
  for (const ExperimentResult& result : results) {
    if (!result.has_runs()) absl::StrAppend(&text, result.title, ":\n\n", ExperimentTables(result, paper));
  }
  return text.empty() ? "" : absl::StrCat("## Experiments without a run\n\n", text);
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
  for (const ExperimentResult& result : results) {
    report.files[absl::StrCat(result.name, ".csv")] = ExperimentCsv(result, paper);
    if (result.has_runs()) text += Section(result, paper, &report.files);
  }
  absl::StrAppend(&text, "## Runs\n\n", RunsTable(runs, cells), EmptyExperiments(results, paper));
  if (!paper.all().empty()) absl::StrAppend(&text, "## Others, for scale\n\n", ScaleTable(paper));
  report.files["report.md"] = std::move(text);
  report.files["runs.csv"] = RunsCsv(runs, cells);
  report.files["achievements.csv"] = AchievementsCsv(results);
  report.files["curves.csv"] = CurvesCsv(results);
  return report;
}

}  // namespace craftfleet
