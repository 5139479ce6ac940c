// Charts of learning curves: runs, drawn over reference curves of other programs.

#ifndef CRAFTFLEET_DEPLOY_CLI_PLOT_CURVE_CHART_H_
#define CRAFTFLEET_DEPLOY_CLI_PLOT_CURVE_CHART_H_

#include <string>
#include <vector>

#include <absl/types/span.h>

#include "deploy/cli/plot/chart.h"
#include "deploy/cli/plot/learning_curve.h"

namespace craftfleet {

struct NamedCurve {
  std::string name;
  LearningCurve curve;  // not empty
};

// Short names that distinguish `paths`: without the folders that all have in common, and without "stats.jsonl".
std::vector<std::string> ShortNames(absl::Span<const std::string> paths);

// Reward of the last 100 episodes, and score over all episodes so far, against environment steps. Curves begin at ten
// episodes, because means over fewer are too noisy. References are dashed grey lines below the runs, and end with the
// longest run.
std::vector<ChartPanel> CurvePanels(absl::Span<const NamedCurve> runs, absl::Span<const NamedCurve> references);

// A line per curve: episodes, steps, reward of the last 100, score. Those of references are at the end of the longest
// run.
std::string CurveTable(absl::Span<const NamedCurve> runs, absl::Span<const NamedCurve> references);

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_CLI_PLOT_CURVE_CHART_H_
