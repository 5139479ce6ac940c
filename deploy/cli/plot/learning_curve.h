// Learning curves, read from the stats.jsonl of a run or from a table of another program.

#ifndef CRAFTFLEET_DEPLOY_CLI_PLOT_LEARNING_CURVE_H_
#define CRAFTFLEET_DEPLOY_CLI_PLOT_LEARNING_CURVE_H_

#include <cstdint>
#include <string>
#include <vector>

#include <absl/status/statusor.h>
#include <absl/types/span.h>

#include "common/base/types.h"
#include "learner/run/score_curve.h"

namespace craftfleet {

using LearningCurve = std::vector<CurvePoint>;  // steps ascending

// A point after each episode, as ScoreCurve counts them.
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
