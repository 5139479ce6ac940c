#include "deploy/cli/report/csv.h"

#include <optional>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_replace.h>

#include "common/base/numbers.h"
#include "deploy/cli/report/curve_spread.h"

namespace craftfleet {
namespace {

// Quoted where CSV needs it.
std::string Text(absl::string_view text) {
  if (text.find_first_of(",\"\n") == absl::string_view::npos) return std::string(text);
  return absl::StrCat("\"", absl::StrReplaceAll(text, {{"\"", "\"\""}}), "\"");
}

std::string Number(const std::optional<double>& value) { return value.has_value() ? ExactNumber(*value) : ""; }

// n,mean,std
std::string SpreadCells(const Spread& spread) {
  return absl::StrCat(spread.n, ",", spread.n == 0 ? "" : ExactNumber(spread.mean), ",", Number(spread.deviation));
}

std::string FigureCells(const PaperFigure* figure) {
  if (figure == nullptr) return ",";
  return absl::StrCat(ExactNumber(figure->mean), ",", Number(figure->deviation));
}

// Calls `add` for each cell with a complete run.
template <typename Add>
void ForCompleteCells(absl::Span<const ExperimentResult> experiments, const Add& add) {
  for (const ExperimentResult& experiment : experiments) {
    for (const CellResult& cell : experiment.cells) {
      if (cell.has_complete()) add(absl::StrCat(Text(experiment.name), ",", Text(cell.name), ","), *cell.group);
    }
  }
}

}  // namespace

std::string ExperimentCsv(const ExperimentResult& experiment, const PaperFigures& paper) {
  std::string text = "experiment,cell,measure,at,n,mean,std,paper_mean,paper_std\n";
  for (const CellResult& cell : experiment.cells) {
    const std::string begin = absl::StrCat(Text(experiment.name), ",", Text(cell.name), ",");
    for (const Measure& measure : Measures()) {
      const Spread spread = cell.group == nullptr ? Spread{} : cell.group->Over(measure.value);
      absl::StrAppend(&text, begin, measure.name, ",,", SpreadCells(spread), ",",
                      FigureCells(paper.Find(experiment.name, cell.name, measure.name)), "\n");
    }
    for (const int64_t steps : experiment.milestones) {
      const Spread spread = cell.group == nullptr ? Spread{} : cell.group->ScoresAt(steps);
      absl::StrAppend(&text, begin, "train,", steps, ",", SpreadCells(spread), ",",
                      FigureCells(paper.Find(experiment.name, cell.name, "train", steps)), "\n");
    }
  }
  return text;
}

std::string AchievementsCsv(absl::Span<const ExperimentResult> experiments) {
  std::string text = "experiment,cell,achievement,n,mean,std\n";
  ForCompleteCells(experiments, [&text](const std::string& begin, const RunGroup& group) {
    for (int i = 0; i < kNumAchievements; ++i) {
      absl::StrAppend(&text, begin, kAchievementNames[i], ",", SpreadCells(group.SuccessOf(i)), "\n");
    }
  });
  return text;
}

std::string CurvesCsv(absl::Span<const ExperimentResult> experiments) {
  std::string text = "experiment,cell,steps,n,score_mean,score_std,reward_mean,reward_std\n";
  ForCompleteCells(experiments, [&text](const std::string& begin, const RunGroup& group) {
    for (const CurveSpread& point : SpreadOfCurves(group.complete, CurveEnd(group.complete[0]->config))) {
      absl::StrAppend(&text, begin, point.steps, ",", SpreadCells(point.score), ",", ExactNumber(point.reward.mean),
                      ",", Number(point.reward.deviation), "\n");
    }
  });
  return text;
}

std::string RunsCsv(absl::Span<const RunRecord> runs, const std::map<std::string, std::string>& cells) {
  std::string text = "folder,cells,agent,env,eval_env,seed,steps,reached,complete";
  for (const Measure& measure : Measures()) absl::StrAppend(&text, ",", measure.name);
  text += "\n";
  for (const RunRecord& run : runs) {
    const auto found = cells.find(run.identity);
    absl::StrAppend(&text, Text(run.folder), ",", found == cells.end() ? "" : found->second, ",",
                    Text(run.config.agent()), ",", Text(run.config.env().name()), ",", Text(run.config.eval().env()));
    absl::StrAppend(&text, ",", run.config.seed(), ",", run.config.steps(), ",", run.steps, ",",
                    run.complete ? "yes" : "no");
    for (const Measure& measure : Measures()) absl::StrAppend(&text, ",", Number(measure.value(run)));
    text += "\n";
  }
  return text;
}

}  // namespace craftfleet
