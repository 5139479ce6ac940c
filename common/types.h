// The plain structs that an action passes through on its way from policy to loss.

#ifndef CRAFTFLEET_COMMON_TYPES_H_
#define CRAFTFLEET_COMMON_TYPES_H_

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "common/crafter.h"

namespace craftfleet {

// How a step left its episode.
enum class StepEnd : uint8_t {
  kNone = 0,        // the episode goes on
  kTerminated = 1,  // the player died: nothing to bootstrap from
  kTruncated = 2,   // the length limit: bootstrap from the last frame
};

// One finished episode, as Crafter's recorder counts it.
struct Episode {
  int step = 0;                                          // step of the fragment at which it ended, 0..T-1
  int64_t length = 0;                                    // steps
  double reward = 0;                                     // sum of rewards, not rounded
  std::array<int32_t, kNumAchievements> achievements{};  // times unlocked
};

// What one step of `n` games gave; rows stand in the request's order.
struct StepBatch {
  std::vector<float> rewards;  // [n]
  std::vector<StepEnd> ends;   // [n]
  std::string frames;          // uint8[n,H,W,3]: the next observation; after an end, the first of the new episode
  std::string last_frames;  // uint8[k,H,W,3]: for each truncated row, in order, the frame in which the episode stopped
  std::vector<Episode> episodes;       // those that ended, in row order
  std::vector<std::string> snapshots;  // [n] where asked for, else empty
};

// What a game looks like at one moment, for videos and files of episodes.
struct Moment {
  std::string frame;                                     // uint8[H,W,3]: what the agent sees
  std::string picture;                                   // uint8[S,S,3]: the same for people; empty if not asked for
  std::string semantic;                                  // uint8[64,64], [x][y]: materials 1..12, objects 13..18
  int player_x = 0;                                      // cells, 0..63
  int player_y = 0;                                      // cells, 0..63
  std::array<int32_t, kNumItems> inventory{};            // 0..9
  std::array<int32_t, kNumAchievements> achievements{};  // times unlocked in this episode so far
};

// Where a lane stands between two fragments: all that it takes to go on with it elsewhere, bit for bit.
struct LaneSnapshot {
  std::string game;          // its state; empty: the lane's first game, not begun yet
  std::vector<float> state;  // [S] recurrent state of the policy; zero at an episode's start
  friend bool operator==(const LaneSnapshot& a, const LaneSnapshot& b) {
    return a.game == b.game && a.state == b.state;
  }
};

// T consecutive steps of one lane under one version of the weights. Byte buffers are std::string so that they move into
// and out of protobuf messages without a copy.
struct Fragment {
  int64_t epoch = 0;                     // learner epoch that permitted it
  int lane = 0;                          // 0..lanes-1
  int64_t number = 0;                    // per lane, from 0
  int64_t policy_version = 0;            // weights that played it
  std::string frames;                    // uint8[T,H,W,3]: what the policy saw before each action
  std::string actions;                   // Action[T], one byte each
  std::vector<float> log_probs;          // [T] of the actions taken
  std::vector<float> values;             // [T]
  std::vector<float> rewards;            // [T]
  std::vector<StepEnd> ends;             // [T]
  std::vector<float> truncation_values;  // [number of kTruncated in ends]: value of each such episode's last frame
  float bootstrap_value = 0;             // value of the observation after the last step
  std::vector<Episode> episodes;         // ended in this fragment, in step order
  // [k,S] recurrent states, S floats each (AgentSpec::state_size): before the first step, k = 1, or, for
  // recurrent_batches PUBLISHED, before each, k = T.
  std::vector<float> states;
  LaneSnapshot snapshot;  // after the last step

  // Added by the learner when it takes the fragment in.
  std::string sender;   // the actor
  uint64_t digest = 0;  // of all that was played
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_TYPES_H_
