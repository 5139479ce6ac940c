#include "deploy/cli/plot/curve_chart.h"

#include <algorithm>

#include <absl/strings/str_format.h>
#include <absl/strings/str_join.h>
#include <absl/strings/str_split.h>
#include <absl/strings/strip.h>

#include "deploy/cli/plot/look.h"

namespace craftfleet {
namespace {

constexpr int kFewestEpisodes = 10;  // means over fewer are too noisy to draw

constexpr double kRunWidth = 1.8;
constexpr double kReferenceWidth = 1.4;

// Colour and dash length (pixels).
struct ReferenceLook {
  uint8_t grey;
  double dash;
};
constexpr ReferenceLook kReferenceLooks[] = {{90, 9}, {150, 9}, {90, 4}, {150, 4}};

Stroke RunStroke(size_t number) { return {SeriesColor(number), kRunWidth}; }

Stroke ReferenceStroke(size_t number) {
  const auto [grey, dash] = kReferenceLooks[number % std::size(kReferenceLooks)];
  return {{grey, grey, grey}, kReferenceWidth, dash};
}

int64_t LongestRun(absl::Span<const NamedCurve> runs) {
  int64_t steps = 0;
  for (const NamedCurve& run : runs) steps = std::max(steps, run.curve.back().steps);
  return steps;
}

// The part of the curve up to `steps`, at least its first point.
LearningCurve CutOff(const LearningCurve& curve, int64_t steps) {
  const auto end = std::upper_bound(curve.begin() + 1, curve.end(), steps,
                                    [](int64_t value, const CurvePoint& point) { return value < point.steps; });
  return {curve.begin(), end};
}

ChartLine LineOf(const std::string& name, const LearningCurve& curve, double CurvePoint::*value, const Stroke& stroke) {
  ChartLine line = {name, stroke, {}, {}};
  for (const CurvePoint& point : curve) {
    if (point.episodes < kFewestEpisodes && &point != &curve.back()) continue;
    line.points.push_back({static_cast<double>(point.steps), point.*value});
  }
  return line;
}

std::string TableLine(size_t name_width, const std::string& name, const CurvePoint& end) {
  return absl::StrFormat("%-*s  %8d  %9d  %16.2f  %5.2f\n", static_cast<int>(name_width), name, end.episodes, end.steps,
                         end.reward, end.score);
}

}  // namespace

std::vector<std::string> ShortNames(absl::Span<const std::string> paths) {
  std::vector<std::vector<std::string>> parts;
  for (const std::string& path : paths) {
    parts.push_back(absl::StrSplit(path, '/', absl::SkipEmpty()));
    std::vector<std::string>& own = parts.back();
    if (own.size() > 1 && (own.back() == "stats.jsonl" || own.back() == "stats.jsonl.gz")) own.pop_back();
  }
  const auto all_share = [&](size_t depth) {
    return std::all_of(parts.begin(), parts.end(),
                       [&](const auto& own) { return own.size() > depth + 1 && own[depth] == parts[0][depth]; });
  };
  size_t shared = 0;
  while (!parts.empty() && all_share(shared)) ++shared;
  std::vector<std::string> names;
  names.reserve(parts.size());
  for (const auto& own : parts) names.push_back(absl::StrJoin(own.begin() + shared, own.end(), "/"));
  return names;
}

std::vector<ChartPanel> CurvePanels(absl::Span<const NamedCurve> runs, absl::Span<const NamedCurve> references) {
  std::vector<ChartPanel> panels = {
      {"Reward", "environment steps", "mean reward of the last 100 episodes", {}},
      {"Crafter score", "environment steps", "score over all episodes so far", {}},
  };
  const int64_t steps = LongestRun(runs);
  const auto add = [&panels](const std::string& name, const LearningCurve& curve, const Stroke& stroke) {
    panels[0].lines.push_back(LineOf(name, curve, &CurvePoint::reward, stroke));
    panels[1].lines.push_back(LineOf(name, curve, &CurvePoint::score, stroke));
  };
  for (size_t i = 0; i < runs.size(); ++i) add(runs[i].name, runs[i].curve, RunStroke(i));
  for (size_t i = 0; i < references.size(); ++i) {
    add(references[i].name, CutOff(references[i].curve, steps), ReferenceStroke(i));
  }
  return panels;
}

std::string CurveTable(absl::Span<const NamedCurve> runs, absl::Span<const NamedCurve> references) {
  size_t width = 3;
  for (const auto& curves : {runs, references}) {
    for (const NamedCurve& curve : curves) width = std::max(width, curve.name.size());
  }
  std::string table = absl::StrFormat("%-*s  %8s  %9s  %16s  %5s\n", static_cast<int>(width), "run", "episodes",
                                      "steps", "reward, last 100", "score");
  const int64_t steps = LongestRun(runs);
  for (const NamedCurve& run : runs) table += TableLine(width, run.name, run.curve.back());
  for (const NamedCurve& reference : references) {
    table += TableLine(width, reference.name, CutOff(reference.curve, steps).back());
  }
  return table;
}

}  // namespace craftfleet
