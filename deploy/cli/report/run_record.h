// The progress and performance of a run, read from its folder.

#ifndef CRAFTFLEET_DEPLOY_CLI_REPORT_RUN_RECORD_H_
#define CRAFTFLEET_DEPLOY_CLI_REPORT_RUN_RECORD_H_

#include <cstdint>
#include <string>
#include <vector>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/types/span.h>

#include "common/base/types.h"
#include "craftfleet/v1/config.pb.h"
#include "deploy/cli/plot/learning_curve.h"
#include "learner/run/score.h"

namespace craftfleet {

// Performance over all episodes of one kind. Undefined without episodes.
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
  v1::RunConfig config;        // complete
  std::string texture_digest;  // of the textures in its run.json; "" without that file
  std::string identity;        // RunIdentity
  int64_t steps = 0;           // environment steps that it has reached according to its files
  bool complete = false;       // it has reached the steps of its configuration, and its evaluations are logged
  Performance training;
  Performance eval_argmax;  // episodes of evaluations during training
  Performance eval_sampled;
  Performance final_argmax;  // episodes of the final evaluation
  Performance final_sampled;
  LearningCurve curve;  // of training; empty without a finished episode
};

// Reads a run folder: config.txt and stats.jsonl, and if they exist run.json, eval_argmax.jsonl, eval_sampled.jsonl,
// final_argmax.jsonl, final_sampled.jsonl and checkpoints/. Logs may be gzipped (.gz).
// A run is complete if its newest checkpoint has reached its steps and no evaluation is pending there. Without
// checkpoints, as in a folder of results, it is complete if it has all episodes of the final evaluation, or if its
// training episodes end in its last iteration. (Episodes are appended to stats.jsonl at the end of an iteration; the
// steps of unfinished episodes are missing there.)
//   InvalidArgument, DataLoss: names the file and the line.
absl::StatusOr<RunRecord> ReadRun(const std::string& folder);

// "4,000 of 8,192": the steps that the run has reached, and those that it trains for, in whole iterations.
std::string StepsText(const RunRecord& run);

struct FoundRuns {
  std::vector<RunRecord> runs;           // sorted by folder
  std::vector<absl::Status> unreadable;  // the errors of folders and runs that cannot be read
};

// All runs in or below `folders`. A folder with config.txt and stats.jsonl is a run.
//   NotFound: no such folder.
absl::StatusOr<FoundRuns> FindRuns(absl::Span<const std::string> folders);

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_CLI_REPORT_RUN_RECORD_H_
