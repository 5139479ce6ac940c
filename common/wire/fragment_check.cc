#include "common/wire/fragment_check.h"

#include <algorithm>
#include <cmath>

#include <absl/strings/str_format.h>

#include "common/base/status_macros.h"
#include "common/base/types.h"
#include "common/io/snapshot_envelope.h"
#include "common/wire/protocol.h"
#include "common/wire/request_check.h"

namespace craftfleet::wire {
namespace {

using Floats = google::protobuf::RepeatedField<float>;

// Tolerance for sums of doubles, which are inexact in their last bits.
constexpr double kSlack = 1e-6;

absl::Status OutOfRange(absl::string_view field, double value, int at, double low, double high) {
  return absl::InvalidArgumentError(absl::StrFormat("%s: %g at %d, want %g..%g", field, value, at, low, high));
}

// Checks that each value is in low..high; NaN is not.
absl::Status CheckRange(absl::string_view field, const Floats& values, float low, float high) {
  for (int i = 0; i < values.size(); ++i) {
    if (!(values[i] >= low && values[i] <= high)) return OutOfRange(field, values[i], i, low, high);
  }
  return absl::OkStatus();
}

float InRange(float value) { return std::clamp(value, -kMaxValue, kMaxValue); }

}  // namespace

void ClampPredictions(Fragment* fragment) {
  for (float& log_prob : fragment->log_probs) log_prob = std::max(log_prob, kMinLogProb);
  for (float& value : fragment->values) value = InRange(value);
  for (float& value : fragment->truncation_values) value = InRange(value);
  fragment->bootstrap_value = InRange(fragment->bootstrap_value);
}

absl::Status CheckStates(absl::string_view field, const Floats& states, int hidden, int64_t max_length) {
  const auto longest = static_cast<float>(max_length) * kMaxHidden;
  for (int i = 0; i < states.size(); ++i) {
    const float most = i / hidden % 2 == 0 ? kMaxHidden : longest;
    if (!(std::abs(states[i]) <= most)) return OutOfRange(field, states[i], i, -most, most);
  }
  return absl::OkStatus();
}

absl::Status CheckRewards(const Floats& rewards) {
  return CheckRange("rewards", rewards, static_cast<float>(kMinStepReward), static_cast<float>(kMaxStepReward));
}

absl::Status CheckValues(const v1::FragmentMessage& message, float low, float high) {
  CRAFTFLEET_RETURN_IF_ERROR(CheckRange("values", message.values(), low, high));
  CRAFTFLEET_RETURN_IF_ERROR(CheckRange("truncation_values", message.truncation_values(), low, high));
  if (message.bootstrap_value() >= low && message.bootstrap_value() <= high) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrFormat("bootstrap_value: %g, want %g..%g", message.bootstrap_value(), low, high));
}

absl::Status CheckRewardSums(const v1::FragmentMessage& message) {
  // An episode that began before the fragment may begin it with any health, and regain all of it.
  constexpr double kHighest = kMaxEpisodeReward - kMinEpisodeReward;
  constexpr double kRounding = 1e-3;  // of as many floats
  double sum = 0;
  for (int t = 0; t < message.rewards_size(); ++t) {
    sum += double{message.rewards(t)};
    const bool ends = t + 1 == message.rewards_size() || message.ends()[t] != static_cast<char>(StepEnd::kNone);
    if (!ends) continue;
    if (!(sum >= kMinEpisodeReward - kRounding && sum <= kHighest + kRounding)) {
      return absl::InvalidArgumentError(absl::StrFormat("rewards: those up to step %d add up to %g, want %g..%g", t,
                                                        sum, kMinEpisodeReward, kHighest));
    }
    sum = 0;
  }
  return absl::OkStatus();
}

absl::Status CheckFragmentValues(const v1::FragmentMessage& message, const FragmentShape& shape) {
  CRAFTFLEET_RETURN_IF_ERROR(CheckCount("epoch", message.epoch(), 0, kMaxCount));
  CRAFTFLEET_RETURN_IF_ERROR(CheckCount("number", message.number(), 0, kMaxCount));
  CRAFTFLEET_RETURN_IF_ERROR(CheckCount("policy_version", message.policy_version(), 0, kMaxCount));
  CRAFTFLEET_RETURN_IF_ERROR(CheckRange("log_probs", message.log_probs(), kMinLogProb, 0));
  CRAFTFLEET_RETURN_IF_ERROR(CheckValues(message, -kMaxValue, kMaxValue));
  CRAFTFLEET_RETURN_IF_ERROR(CheckRewards(message.rewards()));
  CRAFTFLEET_RETURN_IF_ERROR(CheckRewardSums(message));
  CRAFTFLEET_RETURN_IF_ERROR(CheckStates("states", message.states(), shape.hidden, shape.max_length));
  CRAFTFLEET_RETURN_IF_ERROR(CheckStates("last_state", message.last_state(), shape.hidden, shape.max_length));
  if (message.snapshot().empty()) {
    return absl::InvalidArgumentError("snapshot is empty, want the game after the last step");
  }
  return CheckSnapshot(shape.env_digest, message.snapshot());
}

absl::Status CheckEpisode(const v1::EpisodeMessage& message, int64_t min_length, int64_t max_length) {
  if (message.length() < min_length || message.length() > max_length) {
    return absl::InvalidArgumentError(
        absl::StrFormat("episodes: length %d of the one that ended at step %d, want %d..%d", message.length(),
                        message.step(), min_length, max_length));
  }
  if (!(message.reward() >= kMinEpisodeReward - kSlack && message.reward() <= kMaxEpisodeReward + kSlack)) {
    return absl::InvalidArgumentError(
        absl::StrFormat("episodes: reward %g of the one that ended at step %d, want %g..%g", message.reward(),
                        message.step(), kMinEpisodeReward, kMaxEpisodeReward));
  }
  for (const int32_t count : message.achievements()) {
    if (count >= 0 && count <= message.length()) continue;
    return absl::InvalidArgumentError(absl::StrFormat("achievements: %d in an episode of %d steps, want 0..%d", count,
                                                      message.length(), message.length()));
  }
  return absl::OkStatus();
}

absl::Status CheckEpisodes(const google::protobuf::RepeatedPtrField<v1::EpisodeMessage>& episodes, int64_t max_length) {
  int64_t begin = 0;  // of the episode, a step of the fragment
  for (const v1::EpisodeMessage& episode : episodes) {
    const int64_t played = episode.step() + 1 - begin;
    CRAFTFLEET_RETURN_IF_ERROR(CheckEpisode(episode, played, begin == 0 ? max_length : played));
    begin = episode.step() + 1;
  }
  return absl::OkStatus();
}

}  // namespace craftfleet::wire
