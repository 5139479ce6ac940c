// The plain structs that carry steps, episodes and fragments from the game to the loss.

#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "common/base/crafter.h"

namespace craftfleet {

// Whether and how a step ended its episode.
enum class StepEnd : uint8_t {
  kNone = 0,        // the episode continues
  kTerminated = 1,  // the player died: no bootstrapping
  kTruncated = 2,   // the length limit: bootstrap from the last frame
};

// How frames travel; the receiver has the same bytes in the end. Numbered as FrameFormat of types.proto.
enum class FrameFormat : uint8_t {
  kRaw = 0,    // uint8[H,W,3] each
  kScene = 2,  // a scene record each (envserver/render/scene_record.h)
};

// One finished episode, as Crafter's recorder counts it.
struct Episode {
  int step = 0;        // step of the fragment at which it ended, 0..T-1
  int64_t length = 0;  // steps
  double reward = 0;   // sum of rewards, not rounded
  AchievementCounts achievements{};
};

// The result of one step of `n` games; rows are in the order of the request.
struct StepBatch {
  std::vector<float> rewards;  // [n]
  std::vector<StepEnd> ends;   // [n]
  std::string frames;          // uint8[n,H,W,3]: the next observation; after an end, the first of the new episode
  std::string last_frames;  // uint8[k,H,W,3]: for each truncated row, in order, the frame in which the episode stopped
  std::vector<Episode> episodes;       // those that ended, in row order
  std::vector<std::string> snapshots;  // [n] if requested, else empty
};

// The visible state of a game at one moment, for videos and episode files.
struct Moment {
  std::string frame;                           // uint8[H,W,3]: the agent's observation
  std::string picture;                         // uint8[S,S,3]: the same, larger; empty if not requested
  std::string semantic;                        // uint8[64,64], [x][y]: materials 1..12, objects 13..18
  int player_x = 0;                            // cells, 0..63
  int player_y = 0;                            // cells, 0..63
  std::array<int32_t, kNumItems> inventory{};  // 0..9
  AchievementCounts achievements{};            // in this episode so far
};

// Permission to play one fragment of a lane with one version of the weights.
struct Permit {
  int lane = 0;
  int64_t fragment = 0;        // per lane, from 0
  int64_t policy_version = 0;  // weights to play it with
  bool reload = false;         // start from the lane's snapshot, not from a game that is open; not compared by ==
  friend bool operator==(const Permit& a, const Permit& b) {
    return a.lane == b.lane && a.fragment == b.fragment && a.policy_version == b.policy_version;
  }
  friend bool operator!=(const Permit& a, const Permit& b) { return !(a == b); }
};

// A fragment that the learner accepted, and the digest of its content (FragmentDigest).
struct Arrival {
  Permit permit;
  uint64_t digest = 0;
  friend bool operator==(const Arrival& a, const Arrival& b) { return a.permit == b.permit && a.digest == b.digest; }
};

// State of a lane between two fragments: everything that another actor needs to continue it, bit for bit.
struct LaneSnapshot {
  std::string game;          // state of the game; empty: the lane's first game has not begun
  std::vector<float> state;  // [S] recurrent state or memory of the policy; zero at an episode's start
  friend bool operator==(const LaneSnapshot& a, const LaneSnapshot& b) {
    return a.game == b.game && a.state == b.state;
  }
};

// T consecutive steps of one lane under one version of the weights. Byte buffers are std::string so that they move into
// and out of protobuf messages without a copy.
struct Fragment {
  int64_t epoch = 0;                     // learner epoch in which its permit was granted
  int lane = 0;                          // 0..lanes-1
  int64_t number = 0;                    // per lane, from 0
  int64_t policy_version = 0;            // weights that played it
  std::string frames;                    // uint8[T,H,W,3]: the observation before each action
  std::string actions;                   // Action[T], one byte each
  std::vector<float> log_probs;          // [T] of the actions taken
  std::vector<float> values;             // [T]
  std::vector<float> rewards;            // [T]
  std::vector<StepEnd> ends;             // [T]
  std::vector<float> truncation_values;  // [number of kTruncated in ends]: value of each such episode's last frame
  float bootstrap_value = 0;             // value of the observation after the last step
  std::vector<Episode> episodes;         // ended in this fragment, in step order
  // [k,S] states, S floats each (AgentSpec::state_size): before the first step, k = 1, or before each, k = T
  // (KeepsEveryState).
  std::vector<float> states;
  LaneSnapshot snapshot;  // after the last step
  // Of `frames` on their way to the learner; for the learner itself they are raw.
  FrameFormat frame_format = FrameFormat::kRaw;

  // Set by the learner when it receives the fragment.
  std::string scenes;   // the frames as scene records, if they came so; else empty
  std::string sender;   // the actor
  uint64_t digest = 0;  // FragmentDigest of the content
};

}  // namespace craftfleet
