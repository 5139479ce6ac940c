// Learning curves to look at: of runs, over those of other programs.

#ifndef CRAFTFLEET_DEPLOY_PLOT_CURVE_CHART_H_
#define CRAFTFLEET_DEPLOY_PLOT_CURVE_CHART_H_

#include <string>
#include <vector>

#include <absl/types/span.h>

#include "deploy/plot/chart.h"
#include "deploy/plot/learning_curve.h"

namespace craftfleet {

struct NamedCurve {
  std::string name;
  LearningCurve curve;  // not empty
};

// Names for `paths` that tell them apart: without the folders that all share, without "stats.jsonl".
std::vector<std::string> ShortNames(absl::Span<const std::string> paths);

// Reward of the last 100 episodes, and score over all episodes so far, over environment steps. Begins at ten
// episodes, before which both are noise. References are dashed, grey and beneath, as far as the longest run goes.
std::vector<ChartPanel> CurvePanels(absl::Span<const NamedCurve> runs, absl::Span<const NamedCurve> references);

// One line each: episodes, steps, reward of the last 100, score; references where the longest run ends.
std::string CurveTable(absl::Span<const NamedCurve> runs, absl::Span<const NamedCurve> references);

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_PLOT_CURVE_CHART_H_
