// Collects one lane's steps into a fragment.

#pragma once

#include <cstdint>

#include <absl/strings/string_view.h>
#include <absl/types/span.h>

#include "common/base/types.h"

namespace craftfleet {

// Thread-compatible: one thread at a time. Order of calls: Start, Append `steps` times, Finish.
class FragmentBuilder {
 public:
  // Begins a fragment of `steps` steps, and reserves memory for `steps` frames of `frame_bytes` each. `format`: of the
  // fragment; scene records are appended as such, all other frames raw.
  void Start(int64_t epoch, int lane, int64_t number, int64_t policy_version, int steps, int frame_bytes,
             FrameFormat format = FrameFormat::kRaw);

  // Adds the recurrent state before the next step. Called before the first step only, or before each step.
  void AddState(absl::Span<const float> state);
  // Appends a transition: the policy's observation (raw, or its scene record) and action, and the result.
  void Append(absl::string_view frame, Action action, float log_prob, float value, float reward, StepEnd end);
  // Adds the episode that ended with the last appended step.
  void AddEpisode(Episode episode);
  // Adds the value of the last frame of the episode that the last appended step truncated.
  void AddTruncationValue(float value);

  // The number of steps appended so far, 0..T.
  int size() const { return static_cast<int>(fragment_.rewards.size()); }

  Fragment Finish(float bootstrap_value, LaneSnapshot snapshot);

 private:
  Fragment fragment_;
};

}  // namespace craftfleet
