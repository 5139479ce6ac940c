// How well a run did after so many steps: from its stats.jsonl, or from a table of another program's run.

#ifndef CRAFTFLEET_DEPLOY_PLOT_LEARNING_CURVE_H_
#define CRAFTFLEET_DEPLOY_PLOT_LEARNING_CURVE_H_

#include <cstdint>
#include <string>
#include <vector>

#include <absl/status/statusor.h>
#include <absl/types/span.h>

#include "common/types.h"

namespace craftfleet {

struct CurvePoint {
  int64_t episodes = 0;  // finished so far
  int64_t steps = 0;     // environment steps so far
  double reward = 0;     // mean of the last 100 episodes
  double score = 0;      // Crafter's score over all episodes so far, 0..100
};

using LearningCurve = std::vector<CurvePoint>;  // steps ascending

// A point after each episode. Steps are those of the episodes so far in the order of stats.jsonl (iteration, lane,
// step): behind the run's own count by the episodes that are under way.
LearningCurve CurveOfEpisodes(absl::Span<const Episode> episodes);

// `path`: a run's folder, or a stats.jsonl, gzipped or plain.
//   NotFound: no such run.   DataLoss: as ReadStats.   FailedPrecondition: no episode is finished.
absl::StatusOr<LearningCurve> ReadRunCurve(const std::string& path);

// `path`: comma-separated values, the first line naming the columns; those named episodes, steps, ep_rew_mean100 and
// crafter_score_cum count.
//   InvalidArgument: a column is missing, or a value is no number; names line and column.   Others as ReadFile.
absl::StatusOr<LearningCurve> ReadReferenceCurve(const std::string& path);

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_PLOT_LEARNING_CURVE_H_
