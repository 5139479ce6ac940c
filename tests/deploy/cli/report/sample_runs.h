// Run folders whose figures are easy to work out by hand.

#ifndef CRAFTFLEET_TESTS_DEPLOY_CLI_REPORT_SAMPLE_RUNS_H_
#define CRAFTFLEET_TESTS_DEPLOY_CLI_REPORT_SAMPLE_RUNS_H_

#include <string>

#include <gtest/gtest.h>

#include "common/config/config.h"
#include "common/io/files.h"
#include "learner/run/stats_log.h"
#include "tests/fakes/status_matchers.h"

namespace craftfleet {

// `episodes` lines of stats.jsonl, each of 100 steps and reward `unlocked`, with the first `unlocked` achievements: a
// Crafter score of 101^(unlocked / 22) - 1.
inline std::string SameEpisodes(int episodes, int unlocked) {
  Episode episode;
  episode.length = 100;
  episode.reward = unlocked;
  for (int i = 0; i < unlocked; ++i) episode.achievements[i] = 2;
  std::string text;
  for (int i = 0; i < episodes; ++i) text += FormatStatsLine(episode);
  return text;
}

inline void WriteTextFile(const std::string& path, const std::string& text) {
  ASSERT_THAT(CreateFolders(path.substr(0, path.rfind('/'))), IsOk());
  ASSERT_THAT(WriteFileSynced(path, text), IsOk());
}

// A run of 4,000 steps in rollouts of 1,000, of which `episodes` episodes of 100 steps are in its stats.jsonl. `config`
// is laid over.
inline void WriteSampleRun(const std::string& folder, int seed, const std::string& config, int episodes, int unlocked) {
  v1::RunConfig merged =
      ParseRunConfig("steps: 4000 lanes: 10 ppo { rollout_steps: 1000 minibatch_size: 100 }", "base").value();
  merged.set_seed(seed);
  merged.MergeFrom(ParseRunConfig(config, "sample").value());
  WriteTextFile(JoinPath(folder, "config.txt"), FormatRunConfig(merged));
  WriteTextFile(JoinPath(folder, "stats.jsonl"), SameEpisodes(episodes, unlocked));
}

}  // namespace craftfleet

#endif  // CRAFTFLEET_TESTS_DEPLOY_CLI_REPORT_SAMPLE_RUNS_H_
