#include "actor/fragment_builder.h"

#include <algorithm>
#include <utility>

#include "common/wire/fragment_check.h"

namespace craftfleet {
namespace {

constexpr int kRecordBytes = 128;  // of a usual scene record

// Keeps what diverging training predicts within the range that every learner accepts; with normalised values the
// learner's range is narrower (PPO.md, section 9).
float InRange(float value) { return std::clamp(value, -wire::kMaxValue, wire::kMaxValue); }

}  // namespace

void FragmentBuilder::Start(int64_t epoch, int lane, int64_t number, int64_t policy_version, int steps, int frame_bytes,
                            FrameFormat format) {
  fragment_ = Fragment();
  fragment_.epoch = epoch;
  fragment_.lane = lane;
  fragment_.number = number;
  fragment_.policy_version = policy_version;
  fragment_.frame_format = format;
  fragment_.frames.reserve(static_cast<size_t>(steps) * (format == FrameFormat::kScene ? kRecordBytes : frame_bytes));
  fragment_.actions.reserve(steps);
  fragment_.log_probs.reserve(steps);
  fragment_.values.reserve(steps);
  fragment_.rewards.reserve(steps);
  fragment_.ends.reserve(steps);
}

void FragmentBuilder::AddState(absl::Span<const float> state) {
  fragment_.states.insert(fragment_.states.end(), state.begin(), state.end());
}

void FragmentBuilder::Append(absl::string_view frame, Action action, float log_prob, float value, float reward,
                             StepEnd end) {
  fragment_.frames.append(frame.data(), frame.size());
  fragment_.actions.push_back(static_cast<char>(action));
  fragment_.log_probs.push_back(std::max(log_prob, wire::kMinLogProb));
  fragment_.values.push_back(InRange(value));
  fragment_.rewards.push_back(reward);
  fragment_.ends.push_back(end);
}

void FragmentBuilder::AddEpisode(Episode episode) {
  episode.step = size() - 1;
  fragment_.episodes.push_back(episode);
}

void FragmentBuilder::AddTruncationValue(float value) { fragment_.truncation_values.push_back(InRange(value)); }

Fragment FragmentBuilder::Finish(float bootstrap_value, LaneSnapshot snapshot) {
  fragment_.bootstrap_value = InRange(bootstrap_value);
  fragment_.snapshot = std::move(snapshot);
  return std::move(fragment_);
}

}  // namespace craftfleet
