// Ranges of the values of fragments, each with its reason. Values that no game can produce are refused on arrival: a
// learner that accepted them would fail later, when the sender is no longer known.

#pragma once

#include <cstdint>
#include <vector>

#include <absl/status/status.h>
#include <absl/strings/string_view.h>

#include "common/base/crafter.h"
#include "common/base/types.h"
#include "craftfleet/v1/learner.pb.h"

namespace craftfleet::wire {

// The largest length of an episode that any environment allows, in steps.
inline constexpr int64_t kMaxEpisodeLength = 1'000'000'000;
// Smallest log-probability: in float32, exp of less is 0, so such an action is never sampled.
inline constexpr float kMinLogProb = -104;
// Largest absolute value of a critic. Returns stay within about +-22; up to this bound, squares and sums stay finite.
inline constexpr float kMaxValue = 1e6F;
// Largest absolute output of an LSTM, sigmoid * tanh, and of a memory, which has length 1; with room for rounding.
inline constexpr float kMaxHidden = 1.001F;

// The shape of a valid fragment of this run.
struct FragmentShape {
  int lanes = 0;        // lane is in 0..lanes-1
  int steps = 0;        // T
  int frame_bytes = 0;  // H*W*3
  int state_size = 0;   // floats of a state (S): h and c of each LSTM in turn, or a memory; 0: none
  int states = 1;       // recurrent states in the fragment: 1 or `steps`
  int hidden = 1;       // floats of one LSTM's h, and of its c; for a memory, which is bounded like h: the largest int
  uint64_t env_digest = 0;              // of the environment, for snapshots (EnvDigest)
  int64_t max_length = kEpisodeLength;  // steps of an episode
};

// Keeps what diverging training predicts within the ranges that every learner accepts; with normalised values the
// learner's range is narrower (PPO.md, section 9).
void ClampPredictions(Fragment* fragment);

// All of these return InvalidArgument with the field, its value and what was expected.

// Checks the values of a fragment whose fields have the right sizes, and its snapshot, but not its episodes.
absl::Status CheckFragmentValues(const v1::FragmentMessage& message, const FragmentShape& shape);

// Checks one or more recurrent states: h is within +-kMaxHidden; c starts at 0 and grows by at most 1 a step.
//   `field` names it in errors.
absl::Status CheckStates(absl::string_view field, const google::protobuf::RepeatedField<float>& states, int hidden,
                         int64_t max_length);

// Checks the outputs of the value head in a fragment: values, truncation_values and bootstrap_value.
absl::Status CheckValues(const v1::FragmentMessage& message, float low, float high);

// Checks that the rewards of each episode's steps in a fragment add up to what a game can give.
absl::Status CheckRewardSums(const v1::FragmentMessage& message);

// Checks each reward against the range of a step (common/base/crafter.h).
absl::Status CheckRewards(const google::protobuf::RepeatedField<float>& rewards);

// Checks that the length is within `min_length`..`max_length`, the reward within the range of an episode, and that no
// achievement is counted more often than there were steps.
absl::Status CheckEpisode(const v1::EpisodeMessage& message, int64_t min_length, int64_t max_length);

// Checks the episodes that ended in a fragment. From the second on, the length must equal the steps since the previous
// end; the first may have begun in an earlier fragment.
absl::Status CheckEpisodes(const google::protobuf::RepeatedPtrField<v1::EpisodeMessage>& episodes, int64_t max_length);

}  // namespace craftfleet::wire
