// Ranges of what plays bring in. Each has a reason: what honest play can't be, however badly it goes, is refused where
// it comes in, since a learner that took it would break later and could not say of whom.

#ifndef CRAFTFLEET_COMMON_WIRE_FRAGMENT_CHECK_H_
#define CRAFTFLEET_COMMON_WIRE_FRAGMENT_CHECK_H_

#include <cstdint>
#include <vector>

#include <absl/status/status.h>
#include <absl/strings/string_view.h>

#include "common/crafter.h"
#include "common/types.h"
#include "craftfleet/v1/learner.pb.h"

namespace craftfleet::wire {

// Steps of the longest episode that any environment may be asked for.
inline constexpr int64_t kMaxEpisodeLength = 1'000'000'000;
// In float, exp of less is 0: such an action is never drawn.
inline constexpr float kMinLogProb = -104;
// Of a critic. Returns stay within +-22 a life; far beyond them, squares and sums of it are still finite.
inline constexpr float kMaxValue = 1e6F;
// Of an LSTM's output, sigmoid * tanh, with room for how these round.
inline constexpr float kMaxHidden = 1.001F;

// What a valid fragment looks like in this run.
struct FragmentShape {
  int lanes = 0;            // lane is in 0..lanes-1
  int steps = 0;            // T
  int frame_bytes = 0;      // H*W*3
  int state_size = 0;       // floats of a recurrent state (S): h and c of each LSTM in turn; 0: feed-forward
  int states = 1;           // recurrent states that come with it: 1 or `steps`
  int hidden = 1;           // floats of one LSTM's h, and of its c
  uint64_t env_digest = 0;  // of the environment, for snapshots (EnvDigest)
  int64_t max_length = kEpisodeLength;  // steps of an episode
};

// All of these give InvalidArgument with field, value and what was expected.

// Numbers of a fragment whose fields have their sizes, and its snapshot. Its episodes are CheckEpisode's.
absl::Status CheckFragmentValues(const v1::FragmentMessage& message, const FragmentShape& shape);

// Of a recurrent state, or several: h is within +-kMaxHidden; c grows by 1 a step at most and begins with 0.
//   `field` names it in errors.
absl::Status CheckStates(absl::string_view field, const google::protobuf::RepeatedField<float>& states, int hidden,
                         int64_t max_length);

// Each within what a step can give (common/crafter.h).
absl::Status CheckRewards(const google::protobuf::RepeatedField<float>& rewards);

// The length is within `min_length`..`max_length`, the reward within what an episode can give, and no achievement is
// counted more often than there were steps.
absl::Status CheckEpisode(const v1::EpisodeMessage& message, int64_t min_length, int64_t max_length);

// Those that ended in a fragment, at `ends`: from the second on each is as long as the steps since the one before; the
// first may have begun earlier.
absl::Status CheckEpisodes(const google::protobuf::RepeatedPtrField<v1::EpisodeMessage>& episodes, int64_t max_length);

}  // namespace craftfleet::wire

#endif  // CRAFTFLEET_COMMON_WIRE_FRAGMENT_CHECK_H_
