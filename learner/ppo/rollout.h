// The data of one PPO iteration.

#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "common/base/crafter.h"
#include "common/base/types.h"
#include "learner/ppo/gae.h"
#include "learner/ppo/value_norm.h"

namespace craftfleet {

// Whether a row continues the row before it.
enum class RowStart : uint8_t {
  kNone = 0,  // it does: the next step of the same episode
  kFragment,  // it does, in another fragment
  kLane,      // another lane, in the middle of an episode
  kEpisode,   // the first step of an episode
};

// What the advantages of a fragment need beside its rows.
struct RolloutFragment {
  size_t first = 0;  // row
  size_t steps = 0;
  float bootstrap_value = 0;
  std::vector<float> truncation_values;  // of LaneSteps
};

// Rows are steps, lane after lane. Frames and recurrent states stay where they are: in the fragments, which must
// outlive the rollout.
struct Rollout {
  std::vector<const uint8_t*> frames;  // [n] -> uint8[H,W,3]
  std::vector<Action> actions;         // [n]
  std::vector<float> log_probs;        // [n] when the action was chosen, or as CorrectLag changes it
  std::vector<float> values;           // [n] likewise
  std::vector<float> advantages;       // [n] not normalised
  std::vector<float> returns;          // [n]
  std::vector<float> weights;          // [n] of normalised advantages in the loss; empty: 1
  std::vector<float> rewards;          // [n]
  std::vector<StepEnd> ends;           // [n]
  std::vector<RowStart> starts;        // [n]
  std::vector<const float*> states;    // [n] -> float[S] before the step; null: zero, or not kept (kNone)
  std::vector<RolloutFragment> fragments;
  int last_lane = -1;                 // of the last row
  StepEnd last_end = StepEnd::kNone;  // likewise

  size_t size() const { return actions.size(); }
};

struct RolloutOptions {
  int64_t frame_bytes = 0;
  int state_size = 0;        // of the agent's recurrent state or memory (S)
  bool every_state = false;  // fragments hold the state before each step, not just the first
  GaeOptions gae;
  ValueScale value_scale;  // of the values in fragments
};

// Adds the fragment's T steps, with advantages from GAE over the fragment alone. Fragments come lane after lane, each
// lane's in order; wire::FromProto has checked them.
void AppendFragment(const Fragment& fragment, const RolloutOptions& options, Rollout* rollout);

// Puts `values` [n] in the place of those that were played. Where the rollout has the observation after a fragment, the
// value of that replaces the fragment's bootstrap value too.
void ReplaceValues(std::vector<float> values, Rollout* rollout);

// Computes the advantages and returns of all fragments from their values, as AppendFragment does.
void EstimateAdvantages(const GaeOptions& options, Rollout* rollout);

}  // namespace craftfleet
