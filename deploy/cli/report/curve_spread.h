// The learning curves of several seeds combined into one, with their spread.

#ifndef CRAFTFLEET_DEPLOY_CLI_REPORT_CURVE_SPREAD_H_
#define CRAFTFLEET_DEPLOY_CLI_REPORT_CURVE_SPREAD_H_

#include <cstdint>
#include <vector>

#include <absl/types/span.h>

#include "deploy/cli/report/run_group.h"

namespace craftfleet {

struct CurveSpread {
  int64_t steps = 0;
  Spread score;   // over all training episodes so far
  Spread reward;  // mean of the last 100
};

// The end of a complete run's curve in environment steps: its configured steps, at least one iteration.
int64_t CurveEnd(const v1::RunConfig& config);

// 200 equidistant points up to `steps`, from where every run has ten episodes (means over fewer are too noisy). The
// value of a run at a point is that of its last episode so far.
std::vector<CurveSpread> SpreadOfCurves(absl::Span<const RunRecord* const> runs, int64_t steps);

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_CLI_REPORT_CURVE_SPREAD_H_
