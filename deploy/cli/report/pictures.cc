#include "deploy/cli/report/pictures.h"

#include <algorithm>
#include <optional>
#include <utility>

#include <absl/strings/str_cat.h>

#include "deploy/cli/plot/bar_chart.h"
#include "deploy/cli/plot/chart.h"
#include "deploy/cli/plot/heatmap.h"
#include "deploy/cli/plot/look.h"
#include "deploy/cli/report/curve_spread.h"

namespace craftfleet {
namespace {

constexpr double kMeanWidth = 2;
constexpr double kUnfinishedWidth = 1.3;
constexpr double kDash = 6;
constexpr Color kPaperColor = {190, 190, 190};

// One standard deviation to each side; needs two seeds or more.
ChartLine LineOf(const std::string& name, const Stroke& stroke, const std::vector<CurveSpread>& curve,
                 Spread CurveSpread::*value) {
  ChartLine line = {name, stroke, {}, {}};
  for (const CurveSpread& point : curve) {
    const Spread& spread = point.*value;
    const auto steps = static_cast<double>(point.steps);
    line.points.push_back({steps, spread.mean});
    if (!spread.deviation.has_value()) continue;
    line.band.push_back({steps, std::max(0.0, spread.mean - *spread.deviation), spread.mean + *spread.deviation});
  }
  return line;
}

std::string SeedsText(size_t seeds) { return absl::StrCat(" (", seeds, seeds == 1 ? " seed)" : " seeds)"); }

void AddCurves(const CellResult& cell, const Color& color, std::vector<ChartPanel>* panels) {
  const auto add = [panels](const std::string& name, const Stroke& stroke, const std::vector<CurveSpread>& curve) {
    if (curve.empty()) return;
    (*panels)[0].lines.push_back(LineOf(name, stroke, curve, &CurveSpread::score));
    (*panels)[1].lines.push_back(LineOf(name, stroke, curve, &CurveSpread::reward));
  };
  const RunGroup& group = *cell.group;
  if (!group.complete.empty()) {
    add(cell.label + SeedsText(group.complete.size()), {color, kMeanWidth},
        SpreadOfCurves(group.complete, CurveEnd(group.complete[0]->config)));
  }
  for (const RunRecord* run : group.incomplete) {
    add(absl::StrCat(cell.label, ", seed ", run->config.seed(), ", unfinished"), {color, kUnfinishedWidth, kDash},
        SpreadOfCurves({run}, run->steps));
  }
}

std::optional<Bar> BarOf(const Spread& spread) {
  if (spread.n == 0) return std::nullopt;
  return Bar{spread.mean, spread.deviation.value_or(0)};
}

Heatmap MapOf(const std::string& title, const ExperimentAxis& rows, const ExperimentAxis& columns) {
  Heatmap map = {title, {}, {}, {}};
  for (const v1::Choice& choice : rows.choices) map.rows.push_back(choice.label());
  for (const v1::Choice& choice : columns.choices) map.columns.push_back(choice.label());
  map.values.assign(map.rows.size(), std::vector<std::optional<double>>(map.columns.size()));
  return map;
}

std::optional<double> MeanOf(const CellResult& cell, absl::string_view measure) {
  if (cell.group == nullptr) return std::nullopt;
  const Spread spread = cell.group->Over(MeasureNamed(measure).value);
  if (spread.n == 0) return std::nullopt;
  return spread.mean;
}

bool HasValues(const Heatmap& map) {
  return std::any_of(map.values.begin(), map.values.end(), [](const auto& row) {
    return std::any_of(row.begin(), row.end(), [](const auto& value) { return value.has_value(); });
  });
}

// Our maps and the paper's, measure by measure, except for measures without a run.
std::vector<Heatmap> ProductMaps(const ExperimentResult& experiment, const PaperFigures& paper) {
  std::vector<Heatmap> maps;
  for (const auto& [measure, title] : {std::pair("train", "training score"), std::pair("eval", "evaluation score")}) {
    Heatmap ours = MapOf(absl::StrCat("Ours, ", title), experiment.axes[0], experiment.axes[1]);
    Heatmap theirs = MapOf(absl::StrCat("Paper, ", title), experiment.axes[0], experiment.axes[1]);
    for (const CellResult& cell : experiment.cells) {
      ours.values[cell.choices[0]][cell.choices[1]] = MeanOf(cell, measure);
      const PaperFigure* figure = paper.Find(experiment.name, cell.name, measure);
      if (figure != nullptr) theirs.values[cell.choices[0]][cell.choices[1]] = figure->mean;
    }
    if (!HasValues(ours)) continue;
    maps.push_back(std::move(ours));
    if (HasValues(theirs)) maps.push_back(std::move(theirs));
  }
  return maps;
}

// A map for each pair of axes with a run.
std::vector<Heatmap> PairMaps(const ExperimentResult& experiment) {
  std::vector<Heatmap> maps;
  for (size_t a = 0; a < experiment.axes.size(); ++a) {
    for (size_t b = a + 1; b < experiment.axes.size(); ++b) {
      const ExperimentAxis& rows = experiment.axes[a];
      const ExperimentAxis& columns = experiment.axes[b];
      Heatmap map = MapOf(absl::StrCat(rows.name, " (down), ", columns.name, " (across)"), rows, columns);
      for (const CellResult& cell : experiment.cells) {
        if (cell.axes != std::vector<int>{static_cast<int>(a), static_cast<int>(b)}) continue;
        map.values[cell.choices[0]][cell.choices[1]] = MeanOf(cell, "train");
      }
      if (HasValues(map)) maps.push_back(std::move(map));
    }
  }
  return maps;
}

bool HasTwoAxes(const ExperimentResult& experiment) {
  return experiment.combine == v1::Experiment::PAIRS ||
         (experiment.combine == v1::Experiment::PRODUCT && experiment.axes.size() == 2);
}

}  // namespace

std::vector<std::vector<const CellResult*>> ChartParts(const ExperimentResult& experiment) {
  const bool each = experiment.combine == v1::Experiment::EACH && experiment.axes.size() > 1;
  std::vector<std::vector<const CellResult*>> parts;
  int last = -1;
  for (const CellResult& cell : experiment.cells) {
    if (cell.group == nullptr) continue;
    const int place = each ? cell.axes[0] : HasTwoAxes(experiment) ? cell.choices[0] : 0;
    if (parts.empty() || place != last || parts.back().size() == kSeriesColors.size()) parts.emplace_back();
    last = place;
    parts.back().push_back(&cell);
  }
  const auto alone = [](const auto& part) { return part.size() < 2; };
  // True if an axis has nothing to compare: its only cell also appears in the charts of other axes or experiments.
  if (each) parts.erase(std::remove_if(parts.begin(), parts.end(), alone), parts.end());
  return parts;
}

std::optional<Picture> CurvePicture(const std::string& name, const std::string& title,
                                    absl::Span<const CellResult* const> cells) {
  std::vector<ChartPanel> panels = {
      {"Crafter score", "environment steps", "score over all training episodes so far", {}},
      {"Reward", "environment steps", "mean reward of the last 100 episodes", {}},
  };
  for (size_t i = 0; i < cells.size(); ++i) AddCurves(*cells[i], SeriesColor(i), &panels);
  if (panels[0].lines.empty()) return std::nullopt;
  return Picture{name, absl::StrCat("Learning curves: ", title), DrawChart(panels, {})};
}

Picture AchievementPicture(const std::string& name, const std::string& title,
                           absl::Span<const CellResult* const> cells) {
  BarChart chart = {"Success rate of each achievement", "% of training episodes", {}, {}};
  for (const absl::string_view achievement : kAchievementNames) chart.categories.emplace_back(achievement);
  for (size_t i = 0; i < cells.size(); ++i) {
    const RunGroup& group = *cells[i]->group;
    BarSeries series = {cells[i]->label + SeedsText(group.complete.size()), SeriesColor(i), {}, ""};
    for (int a = 0; a < kNumAchievements; ++a) series.bars.push_back(BarOf(group.SuccessOf(a)));
    chart.series.push_back(std::move(series));
  }
  return {name, absl::StrCat("Success rates: ", title), DrawBars(chart)};
}

Picture ScorePicture(const ExperimentResult& experiment, const PaperFigures& paper) {
  BarChart chart = {experiment.title, "Crafter score of training episodes", {}, {}};
  BarSeries ours = {"ours", SeriesColor(0), {}, "no run"};
  BarSeries theirs = {"paper", kPaperColor, {}, ""};
  for (const CellResult& cell : experiment.cells) {
    const PaperFigure* figure = paper.Find(experiment.name, cell.name, "train");
    const Spread spread = cell.group == nullptr ? Spread{} : cell.group->Over(MeasureNamed("train").value);
    if (figure == nullptr && spread.n == 0) continue;
    chart.categories.push_back(cell.label);
    ours.bars.push_back(BarOf(spread));
    theirs.bars.push_back(figure == nullptr ? std::nullopt
                                            : std::optional<Bar>({figure->mean, figure->deviation.value_or(0)}));
  }
  const bool compared =
      std::any_of(theirs.bars.begin(), theirs.bars.end(), [](const auto& bar) { return bar.has_value(); });
  if (!compared) ours.name.clear();
  chart.series.push_back(std::move(ours));
  if (compared) chart.series.push_back(std::move(theirs));
  return {absl::StrCat(experiment.name, "-scores.png"), absl::StrCat("Scores: ", experiment.title), DrawBars(chart)};
}

std::optional<Picture> HeatmapPicture(const ExperimentResult& experiment, const PaperFigures& paper) {
  const bool pairs = experiment.combine == v1::Experiment::PAIRS;
  const std::vector<Heatmap> maps = pairs ? PairMaps(experiment) : ProductMaps(experiment, paper);
  if (maps.empty()) return std::nullopt;
  return Picture{absl::StrCat(experiment.name, "-heatmap.png"), absl::StrCat("Heatmap: ", experiment.title),
                 DrawHeatmaps(maps, 2)};
}

std::vector<Picture> ExperimentPictures(const ExperimentResult& experiment, const PaperFigures& paper) {
  std::vector<Picture> pictures;
  const bool any_complete = std::any_of(experiment.cells.begin(), experiment.cells.end(),
                                        [](const CellResult& cell) { return cell.has_complete(); });
  if (HasTwoAxes(experiment)) {
    if (std::optional<Picture> map = HeatmapPicture(experiment, paper)) pictures.push_back(*std::move(map));
  } else if (any_complete && experiment.milestones.empty()) {
    pictures.push_back(ScorePicture(experiment, paper));
  }
  if (experiment.combine == v1::Experiment::PAIRS) return pictures;
  const auto parts = ChartParts(experiment);
  for (size_t i = 0; i < parts.size(); ++i) {
    const std::string number = parts.size() == 1 ? "" : absl::StrCat("-", i + 1);
    std::optional<Picture> curves =
        CurvePicture(absl::StrCat(experiment.name, "-curves", number, ".png"), experiment.title, parts[i]);
    if (curves.has_value()) pictures.push_back(*std::move(curves));
    std::vector<const CellResult*> complete;
    for (const CellResult* cell : parts[i]) {
      if (cell->has_complete()) complete.push_back(cell);
    }
    if (complete.empty()) continue;
    pictures.push_back(
        AchievementPicture(absl::StrCat(experiment.name, "-achievements", number, ".png"), experiment.title, complete));
  }
  return pictures;
}

}  // namespace craftfleet
