// What a run's folder tells: how far it is, how well it played.

#ifndef CRAFTFLEET_DEPLOY_REPORT_RUN_RECORD_H_
#define CRAFTFLEET_DEPLOY_REPORT_RUN_RECORD_H_

#include <cstdint>
#include <string>
#include <vector>

#include <absl/status/statusor.h>
#include <absl/types/span.h>

#include "common/types.h"
#include "craftfleet/v1/config.pb.h"
#include "deploy/plot/learning_curve.h"
#include "learner/run/score.h"

namespace craftfleet {

// Of the episodes of one kind; of no use without episodes.
struct Performance {
  int64_t episodes = 0;
  double score = 0;          // Crafter's, over all of them
  double reward = 0;         // mean
  double recent_reward = 0;  // mean of the last 100
  int unlocked = 0;          // achievements unlocked in at least one; 0..22
  AchievementPercentages success{};
};

Performance PerformanceOf(absl::Span<const Episode> episodes);

struct RunRecord {
  std::string folder;
  v1::RunConfig config;   // complete
  std::string identity;   // RunIdentity
  int64_t steps = 0;      // environment steps that it has reached, as far as its files tell
  bool complete = false;  // reached those of its configuration
  Performance training;
  Performance eval_argmax;  // episodes of evaluations during training
  Performance eval_sampled;
  Performance final_argmax;  // after it
  Performance final_sampled;
  LearningCurve curve;  // of training; empty without a finished episode
};

// Reads a run's folder: config.txt and stats.jsonl; eval_argmax.jsonl, eval_sampled.jsonl, final_argmax.jsonl,
// final_sampled.jsonl and checkpoints/ where they are there; logs plain or as .gz.
// A run is complete if its newest checkpoint has reached its steps. Without checkpoints, as where results are kept,
// by its episodes: those after training are there, or those of training end in its last iteration (the steps of
// episodes that were under way at the end are not in stats.jsonl; episodes get there at the end of an iteration).
//   InvalidArgument, DataLoss: names the file and the line.
absl::StatusOr<RunRecord> ReadRun(const std::string& folder);

// Every run in or below `folders`, sorted by folder. A folder with config.txt and stats.jsonl is a run.
//   NotFound: no such folder.   Others as ReadRun.
absl::StatusOr<std::vector<RunRecord>> FindRuns(absl::Span<const std::string> folders);

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_REPORT_RUN_RECORD_H_
