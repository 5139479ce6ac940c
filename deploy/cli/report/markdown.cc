#include "deploy/cli/report/markdown.h"

#include <algorithm>
#include <utility>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/strings/str_join.h>

#include "common/base/numbers.h"

namespace craftfleet {
namespace {

constexpr char kPlusMinus[] = "±";
constexpr char kAverage[] = "average";
constexpr size_t kNamedCells = 8;  // in the line above a folded table

// The rows that a table shows: rows without a run are folded away.
enum class Rows { kWithRuns, kWithoutRuns };

bool HasRuns(absl::Span<const CellResult* const> row) {
  return std::any_of(row.begin(), row.end(), [](const CellResult* cell) { return cell->group != nullptr; });
}

bool IsShown(absl::Span<const CellResult* const> row, Rows rows) { return HasRuns(row) == (rows == Rows::kWithRuns); }

std::string FigureText(const PaperFigure& figure) {
  const int n = figure.deviation.has_value() ? 2 : 1;  // any number with and without a deviation
  return FormatSpread({n, figure.mean, figure.deviation}, kPlusMinus);
}

// "" without a figure.
std::string FigureText(const PaperFigure* figure) { return figure == nullptr ? "" : FigureText(*figure); }

std::string SeedsAt(const RunGroup& group) {
  return absl::StrJoin(group.incomplete, ", ", [](std::string* out, const RunRecord* run) {
    absl::StrAppend(out, "seed ", run->config.seed(), " at ", StepsText(*run), " steps");
  });
}

// "10.3 ± 0.6", with the number of seeds if `with_seeds`; or the reason why there is no number.
std::string OursText(const CellResult& cell, const Spread& spread, bool with_seeds) {
  if (cell.group == nullptr) return "no run";
  if (!cell.has_complete()) return absl::StrCat("unfinished: ", SeedsAt(*cell.group));
  if (spread.n == 0 || !with_seeds) return FormatSpread(spread, kPlusMinus);
  return absl::StrCat(FormatSpread(spread, kPlusMinus), " (n=", spread.n, ")");
}

Spread SpreadIn(const CellResult& cell, const Measure& measure) {
  return cell.group == nullptr ? Spread{} : cell.group->Over(measure.value);
}

// Our value, with the paper's below it.
std::string OursOverPaper(const std::string& ours, const PaperFigure* figure) {
  return figure == nullptr ? ours : absl::StrCat(ours, "<br>*paper ", FigureText(*figure), "*");
}

// The list below a table of runs that are not in its means.
std::string Notes(absl::Span<const CellResult* const> cells) {
  std::string notes;
  for (const CellResult* cell : cells) {
    if (!cell->has_complete() || cell->group->incomplete.empty()) continue;
    absl::StrAppend(&notes, "- ", cell->label, ": not averaged because unfinished: ", SeedsAt(*cell->group), "\n");
  }
  for (const CellResult* cell : cells) {
    if (cell->group == nullptr) continue;
    for (const RunRecord* run : cell->group->repeated) {
      absl::StrAppend(&notes, "- ", cell->label, ": ", run->folder, " not counted, seed ", run->config.seed(),
                      " is there already\n");
    }
  }
  return notes.empty() ? "" : absl::StrCat(notes, "\n");
}

// One row per cell.
std::string RowTable(const ExperimentResult& experiment, const std::string& first_column,
                     absl::Span<const CellResult* const> cells, const PaperFigures& paper) {
  const bool compared = std::any_of(cells.begin(), cells.end(), [&](const CellResult* cell) {
    return paper.Find(experiment.name, cell->name, "train") != nullptr;
  });
  std::vector<std::string> header = {first_column};
  if (compared) header.emplace_back("paper");
  header.emplace_back(compared ? "ours" : MeasureNamed("train").label);
  header.emplace_back("seeds");
  constexpr absl::string_view kMore[] = {"eval", "eval_argmax", "reward", "reward_last100", "unlocked"};
  for (const absl::string_view name : kMore) header.emplace_back(MeasureNamed(name).label);
  std::vector<std::vector<std::string>> rows;
  for (const CellResult* cell : cells) {
    const Spread score = SpreadIn(*cell, MeasureNamed("train"));
    std::vector<std::string> row = {cell->label};
    if (compared) row.push_back(FigureText(paper.Find(experiment.name, cell->name, "train")));
    row.push_back(OursText(*cell, score, /*with_seeds=*/false));
    row.push_back(cell->has_complete() ? absl::StrCat(score.n) : "");
    for (const absl::string_view name : kMore) {
      const std::string ours =
          cell->has_complete() ? FormatSpread(SpreadIn(*cell, MeasureNamed(name)), kPlusMinus) : "";
      row.push_back(OursOverPaper(ours, paper.Find(experiment.name, cell->name, name)));
    }
    rows.push_back(std::move(row));
  }
  return absl::StrCat(MarkdownTable(header, rows), Notes(cells));
}

// One row per cell, a column per milestone.
std::string MilestoneTable(const ExperimentResult& experiment, absl::Span<const CellResult* const> cells,
                           const PaperFigures& paper) {
  std::vector<std::string> header = {experiment.axes.empty() ? "" : experiment.axes[0].name};
  for (const int64_t steps : experiment.milestones) header.push_back(absl::StrCat(WithCommas(steps), " steps"));
  std::vector<std::vector<std::string>> rows;
  for (const CellResult* cell : cells) {
    std::vector<std::string> row = {cell->label};
    for (const int64_t steps : experiment.milestones) {
      const Spread spread = cell->group == nullptr ? Spread{} : cell->group->ScoresAt(steps);
      const std::string ours = cell->group == nullptr ? "no run"
                               : spread.n == 0        ? "not reached"
                                               : absl::StrCat(FormatSpread(spread, kPlusMinus), " (n=", spread.n, ")");
      row.push_back(OursOverPaper(ours, paper.Find(experiment.name, cell->name, "train", steps)));
    }
    rows.push_back(std::move(row));
  }
  const bool unfinished = std::any_of(cells.begin(), cells.end(), [](const CellResult* cell) {
    return cell->group != nullptr && !cell->group->incomplete.empty();
  });
  return absl::StrCat(MarkdownTable(header, rows),
                      unfinished ? "Unfinished runs count up to the steps that they have reached.\n\n" : "");
}

// The mean of a column's means and of its deviations, as in the average rows of the paper.
std::string AverageText(const std::vector<const CellResult*>& column, const Measure& measure) {
  double mean = 0;
  double deviation = 0;
  int cells = 0;
  int deviations = 0;
  for (const CellResult* cell : column) {
    const Spread spread = SpreadIn(*cell, measure);
    if (spread.n == 0) continue;
    ++cells;
    mean += spread.mean;
    if (spread.deviation.has_value()) {
      ++deviations;
      deviation += *spread.deviation;
    }
  }
  const int all = static_cast<int>(column.size());
  if (cells < all) return absl::StrCat(cells, " of ", all, " rows have runs");
  Spread average = {1, mean / all, std::nullopt};
  if (deviations == all) average.deviation = deviation / all;
  return FormatSpread(average, kPlusMinus);
}

// The cells that vary exactly these two axes, row by row.
std::vector<std::vector<const CellResult*>> Matrix(const ExperimentResult& experiment, int row_axis, int column_axis) {
  std::vector<std::vector<const CellResult*>> matrix(
      experiment.axes[row_axis].choices.size(),
      std::vector<const CellResult*>(experiment.axes[column_axis].choices.size()));
  for (const CellResult& cell : experiment.cells) {
    if (cell.axes == std::vector<int>{row_axis, column_axis}) matrix[cell.choices[0]][cell.choices[1]] = &cell;
  }
  return matrix;
}

std::vector<const CellResult*> AllCells(const ExperimentResult& experiment) {
  std::vector<const CellResult*> cells;
  for (const CellResult& cell : experiment.cells) cells.push_back(&cell);
  return cells;
}

void AddAverageRows(const ExperimentResult& experiment, const std::vector<std::vector<const CellResult*>>& matrix,
                    absl::Span<const absl::string_view> measures, const PaperFigures& paper,
                    std::vector<std::vector<std::string>>* rows) {
  const auto& columns = experiment.axes[1].choices;
  const auto figure = [&](size_t column, absl::string_view measure) {
    return paper.Find(experiment.name, absl::StrCat(kAverage, "/", columns[column].name()), measure);
  };
  for (const absl::string_view measure : measures) {
    if (figure(0, measure) == nullptr) return;
    std::vector<std::string> row = {measure == measures[0] ? kAverage : "", std::string(MeasureNamed(measure).label)};
    for (size_t c = 0; c < columns.size(); ++c) {
      std::vector<const CellResult*> column;
      for (const auto& cells : matrix) column.push_back(cells[c]);
      row.push_back(OursOverPaper(AverageText(column, MeasureNamed(measure)), figure(c, measure)));
    }
    rows->push_back(std::move(row));
  }
}

// Two axes against each other: training and evaluation scores, followed by averages if the paper has them. If rows are
// folded, the averages come after them.
std::string ProductTable(const ExperimentResult& experiment, const PaperFigures& paper, Rows shown) {
  constexpr absl::string_view kShown[] = {"train", "eval"};
  const auto matrix = Matrix(experiment, 0, 1);
  std::vector<std::string> header = {experiment.axes[0].name, ""};
  for (const v1::Choice& choice : experiment.axes[1].choices) header.push_back(choice.label());
  std::vector<std::vector<std::string>> rows;
  std::vector<const CellResult*> cells;
  for (size_t r = 0; r < matrix.size(); ++r) {
    if (!IsShown(matrix[r], shown)) continue;
    cells.insert(cells.end(), matrix[r].begin(), matrix[r].end());
    for (const absl::string_view measure : kShown) {
      std::vector<std::string> row = {measure == kShown[0] ? experiment.axes[0].choices[r].label() : "",
                                      std::string(MeasureNamed(measure).label)};
      for (const CellResult* cell : matrix[r]) {
        const std::string ours = OursText(*cell, SpreadIn(*cell, MeasureNamed(measure)), /*with_seeds=*/true);
        row.push_back(OursOverPaper(ours, paper.Find(experiment.name, cell->name, measure)));
      }
      rows.push_back(std::move(row));
    }
  }
  if (rows.empty()) return "";
  const bool any_folded = !std::all_of(matrix.begin(), matrix.end(), [](const auto& row) { return HasRuns(row); });
  if (any_folded == (shown == Rows::kWithoutRuns)) AddAverageRows(experiment, matrix, kShown, paper, &rows);
  return absl::StrCat(MarkdownTable(header, rows), Notes(cells));
}

std::string PairTables(const ExperimentResult& experiment, Rows shown) {
  std::string text;
  for (int a = 0; a < static_cast<int>(experiment.axes.size()); ++a) {
    for (int b = a + 1; b < static_cast<int>(experiment.axes.size()); ++b) {
      std::vector<std::string> header = {absl::StrCat(experiment.axes[a].name, " \\ ", experiment.axes[b].name)};
      for (const v1::Choice& choice : experiment.axes[b].choices) header.push_back(choice.label());
      std::vector<std::vector<std::string>> rows;
      const auto matrix = Matrix(experiment, a, b);
      for (size_t r = 0; r < matrix.size(); ++r) {
        if (!IsShown(matrix[r], shown)) continue;
        std::vector<std::string> row = {experiment.axes[a].choices[r].label()};
        for (const CellResult* cell : matrix[r]) {
          row.push_back(OursText(*cell, SpreadIn(*cell, MeasureNamed("train")), /*with_seeds=*/true));
        }
        rows.push_back(std::move(row));
      }
      if (!rows.empty()) text += MarkdownTable(header, rows);
    }
  }
  return text;
}

// The table of those of `cells` that are shown, a row each; "" without any.
std::string CellTable(const ExperimentResult& experiment, const std::string& first_column,
                      std::vector<const CellResult*> cells, const PaperFigures& paper, Rows shown) {
  cells.erase(
      std::remove_if(cells.begin(), cells.end(), [&](const CellResult* cell) { return !IsShown({cell}, shown); }),
      cells.end());
  if (cells.empty()) return "";
  return experiment.milestones.empty() ? RowTable(experiment, first_column, cells, paper)
                                       : MilestoneTable(experiment, cells, paper);
}

std::string Tables(const ExperimentResult& experiment, const PaperFigures& paper, Rows shown) {
  if (experiment.milestones.empty() && experiment.combine == v1::Experiment::PAIRS) {
    return PairTables(experiment, shown);
  }
  if (experiment.milestones.empty() && experiment.combine == v1::Experiment::PRODUCT && experiment.axes.size() == 2) {
    return ProductTable(experiment, paper, shown);
  }
  if (!experiment.milestones.empty() || experiment.combine == v1::Experiment::PRODUCT) {
    return CellTable(experiment, experiment.axes.size() == 1 ? experiment.axes[0].name : "", AllCells(experiment),
                     paper, shown);
  }
  std::string text;
  for (int axis = 0; axis < static_cast<int>(experiment.axes.size()); ++axis) {
    std::vector<const CellResult*> cells;
    for (const CellResult& cell : experiment.cells) {
      if (cell.axes[0] == axis) cells.push_back(&cell);
    }
    text += CellTable(experiment, experiment.axes[axis].name, cells, paper, shown);
  }
  return text;
}

// "4 cells without a run: PPO-SPCNN; LSTM-SPCNN; OC-SA; OC-CA"
std::string CellsWithoutRuns(const ExperimentResult& experiment) {
  std::vector<std::string> labels;
  for (const CellResult& cell : experiment.cells) {
    if (cell.group == nullptr) labels.push_back(cell.label);
  }
  const std::string count = absl::StrCat(labels.size(), labels.size() == 1 ? " cell" : " cells", " without a run");
  return labels.size() > kNamedCells ? count : absl::StrCat(count, ": ", absl::StrJoin(labels, "; "));
}

}  // namespace

std::string MarkdownTable(const std::vector<std::string>& header, const std::vector<std::vector<std::string>>& rows) {
  std::string text = absl::StrCat("| ", absl::StrJoin(header, " | "), " |\n|");
  for (size_t i = 0; i < header.size(); ++i) text += "---|";
  text += "\n";
  for (const std::vector<std::string>& row : rows) absl::StrAppend(&text, "| ", absl::StrJoin(row, " | "), " |\n");
  return absl::StrCat(text, "\n");
}

std::string Folded(absl::string_view summary, absl::string_view text) {
  return absl::StrCat("<details><summary>", summary, "</summary>\n\n", text, "</details>\n\n");
}

std::string ExperimentTables(const ExperimentResult& experiment, const PaperFigures& paper) {
  const std::string folded = Tables(experiment, paper, Rows::kWithoutRuns);
  return absl::StrCat(Tables(experiment, paper, Rows::kWithRuns),
                      folded.empty() ? "" : Folded(CellsWithoutRuns(experiment), folded));
}

std::string AchievementTable(absl::Span<const CellResult* const> cells) {
  std::vector<std::string> header = {"success rate, %"};
  for (const CellResult* cell : cells) header.push_back(cell->label);
  std::vector<std::vector<std::string>> rows;
  for (int i = 0; i < kNumAchievements; ++i) {
    std::vector<std::string> row = {std::string(kAchievementNames[i])};
    for (const CellResult* cell : cells) {
      row.push_back(FormatSpread(cell->group->SuccessOf(i), kPlusMinus));
    }
    rows.push_back(std::move(row));
  }
  return MarkdownTable(header, rows);
}

std::string ScaleTable(const PaperFigures& paper) {
  std::vector<std::vector<std::string>> rows;
  for (const PaperFigure& figure : paper.all()) {
    if (figure.table != "scale" || figure.measure != "train") continue;
    rows.push_back({figure.cell, FigureText(figure), FigureText(paper.Find("scale", figure.cell, "reward", figure.at)),
                    figure.source});
  }
  return MarkdownTable({"", "Crafter score", "reward", "source"}, rows);
}

}  // namespace craftfleet
