// Episodes and checkpoints to test with.

#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "common/base/types.h"
#include "common/config/config.h"
#include "common/io/files.h"
#include "learner/run/checkpoint.h"
#include "learner/run/stats_log.h"

namespace craftfleet {

// Every second achievement is unlocked, `length` times modulo 3.
inline Episode SampleEpisode(int64_t length, double reward) {
  Episode episode;
  episode.length = length;
  episode.reward = reward;
  for (int i = 0; i < kNumAchievements; i += 2) episode.achievements[i] = static_cast<int32_t>(length % 3);
  return episode;
}

// The episodes of a whole log.
inline std::vector<Episode> ReadStats(const std::string& path) {
  std::vector<Episode> episodes;
  EXPECT_TRUE(VisitStats(path, FileSize(path).value(), [&](const Episode& e) { episodes.push_back(e); }).ok());
  return episodes;
}

inline Checkpoint SampleCheckpoint(int64_t iteration, double best_score = 0) {
  Checkpoint checkpoint;
  checkpoint.weights =
      std::make_shared<const std::string>("weights " + std::to_string(iteration) + std::string(3000, 'w'));
  checkpoint.optimizer = "optimizer " + std::to_string(iteration) + std::string("\0\n", 2);
  v1::CheckpointState& state = checkpoint.state;
  *state.mutable_config() = ResolveRunConfig(DefaultRunConfig()).value();
  state.set_program_version("0.2.0");
  state.set_run_id("20231114-221320-abcdef");
  state.set_iteration(iteration);
  state.set_env_steps(iteration * 4096);
  state.set_policy_version(iteration);
  state.set_optimizer_steps(iteration * 128);
  state.set_best_score(best_score);
  for (int lane = 0; lane < state.config().lanes(); ++lane) {
    v1::LaneState* lane_state = state.add_lanes();
    lane_state->set_next_fragment(iteration);
    lane_state->set_snapshot("snapshot of lane " + std::to_string(lane));
  }
  return checkpoint;
}

}  // namespace craftfleet
