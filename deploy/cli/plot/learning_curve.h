// Learning curves, read from the stats.jsonl of a run or from a table of another program.

#ifndef CRAFTFLEET_DEPLOY_CLI_PLOT_LEARNING_CURVE_H_
#define CRAFTFLEET_DEPLOY_CLI_PLOT_LEARNING_CURVE_H_

#include <cstdint>
#include <string>
#include <vector>

#include <absl/status/statusor.h>
#include <absl/types/span.h>

#include "common/base/types.h"

namespace craftfleet {

struct CurvePoint {
  int64_t episodes = 0;  // finished so far
  int64_t steps = 0;     // environment steps so far
  double reward = 0;     // mean of the last 100 episodes
  double score = 0;      // Crafter's score over all episodes so far, 0..100
};

using LearningCurve = std::vector<CurvePoint>;  // steps ascending

// A point after each episode. It counts the steps of finished episodes in the order of stats.jsonl (iteration, lane,
// step). The run's own count is higher, because it includes unfinished episodes.
LearningCurve CurveOfEpisodes(absl::Span<const Episode> episodes);

// `path`: a run's folder, or a stats.jsonl, gzipped or plain.
//   NotFound: no such run.   DataLoss: as ReadStats.   FailedPrecondition: no finished episode.
absl::StatusOr<LearningCurve> ReadRunCurve(const std::string& path);

// `path`: comma-separated values with column names in the first line, of which episodes, steps, ep_rew_mean100 and
// crafter_score_cum are read.
//   InvalidArgument: a column is missing, or a value is not a number; names line and column.   Others as ReadFile.
absl::StatusOr<LearningCurve> ReadReferenceCurve(const std::string& path);

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_CLI_PLOT_LEARNING_CURVE_H_
