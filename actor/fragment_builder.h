// Collects one lane's steps into a fragment.

#ifndef CRAFTFLEET_ACTOR_FRAGMENT_BUILDER_H_
#define CRAFTFLEET_ACTOR_FRAGMENT_BUILDER_H_

#include <cstdint>

#include <absl/strings/string_view.h>
#include <absl/types/span.h>

#include "common/types.h"

namespace craftfleet {

// Thread-compatible: one thread at a time. Order of calls: Start, Append `steps` times, Finish.
class FragmentBuilder {
 public:
  // Begins a fragment of `steps` steps; memory for `steps` frames of `frame_bytes` is taken at once.
  void Start(int64_t epoch, int lane, int64_t number, int64_t policy_version, int steps, int frame_bytes);

  // The recurrent state before the step that is appended next: once, before the first step, or before each.
  void AddState(absl::Span<const float> state);
  // One transition: what the policy saw and did, and what came of it.
  void Append(absl::string_view frame, Action action, float log_prob, float value, float reward, StepEnd end);
  // The episode that ended with the step appended last.
  void AddEpisode(Episode episode);
  // Value of the last frame of the episode truncated by the step appended last.
  void AddTruncationValue(float value);

  // Number of steps appended so far, 0..T.
  int size() const { return static_cast<int>(fragment_.rewards.size()); }

  Fragment Finish(float bootstrap_value, LaneSnapshot snapshot);

 private:
  Fragment fragment_;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_ACTOR_FRAGMENT_BUILDER_H_
