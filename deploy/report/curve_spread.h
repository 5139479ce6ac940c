// The learning curves of several seeds as one, with their spread.

#ifndef CRAFTFLEET_DEPLOY_REPORT_CURVE_SPREAD_H_
#define CRAFTFLEET_DEPLOY_REPORT_CURVE_SPREAD_H_

#include <cstdint>
#include <vector>

#include <absl/types/span.h>

#include "deploy/report/run_group.h"

namespace craftfleet {

struct CurveSpread {
  int64_t steps = 0;
  Spread score;   // over all training episodes so far
  Spread reward;  // mean of the last 100
};

// At 200 equal steps up to `steps`, from where every run has ten episodes on (figures over fewer are noise). A run
// counts with its last episode until then.
std::vector<CurveSpread> SpreadOfCurves(absl::Span<const RunRecord* const> runs, int64_t steps);

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_REPORT_CURVE_SPREAD_H_
