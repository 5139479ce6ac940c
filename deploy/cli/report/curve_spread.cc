#include "deploy/cli/report/curve_spread.h"

#include <algorithm>

namespace craftfleet {
namespace {

constexpr int kPoints = 200;
constexpr int64_t kFewestEpisodes = 10;

// The last point at `steps` or before; nullptr if there is none.
const CurvePoint* PointAt(const LearningCurve& curve, int64_t steps) {
  const auto after = std::upper_bound(curve.begin(), curve.end(), steps,
                                      [](int64_t value, const CurvePoint& point) { return value < point.steps; });
  if (after == curve.begin() || std::prev(after)->episodes < kFewestEpisodes) return nullptr;
  return &*std::prev(after);
}

}  // namespace

int64_t CurveEnd(const v1::RunConfig& config) {
  return std::max<int64_t>(config.steps(), config.ppo().rollout_steps());
}

std::vector<CurveSpread> SpreadOfCurves(absl::Span<const RunRecord* const> runs, int64_t steps) {
  std::vector<CurveSpread> curve;
  for (int i = 1; i <= kPoints; ++i) {
    const int64_t at = steps * i / kPoints;
    std::vector<double> scores;
    std::vector<double> rewards;
    for (const RunRecord* run : runs) {
      const CurvePoint* point = PointAt(run->curve, at);
      if (point == nullptr) break;
      scores.push_back(point->score);
      rewards.push_back(point->reward);
    }
    if (scores.size() == runs.size() && !runs.empty()) curve.push_back({at, SpreadOf(scores), SpreadOf(rewards)});
  }
  return curve;
}

}  // namespace craftfleet
