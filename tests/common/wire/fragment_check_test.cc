// Both ends of every range of a fragment's values, and the next value beyond each.
#include "common/wire/fragment_check.h"

#include <cmath>
#include <functional>
#include <limits>
#include <ostream>
#include <string>
#include <utility>
#include <vector>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/wire/convert.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/wire_samples.h"

namespace craftfleet {
namespace fragment_check_test {

using testing::AllOf;
using testing::HasSubstr;

using Message = v1::FragmentMessage;

constexpr float kInfinity = std::numeric_limits<float>::infinity();

// A number in the message, and its accepted range.
struct Range {
  std::string field;
  std::function<void(Message*, float)> set;
  float low;
  float high;
  friend void PrintTo(const Range& range, std::ostream* out) { *out << range.field; }
};

absl::Status Check(const Message& message) {
  Message copy = message;
  return wire::FromProto(&copy, kSampleShape).status();
}

class FragmentRange : public testing::TestWithParam<Range> {
 protected:
  static absl::Status CheckWith(float value) {
    Message message = wire::ToProto(SampleFragment(2, 7, 40));
    GetParam().set(&message, value);
    return Check(message);
  }
};

TEST_P(FragmentRange, AcceptsExactlyItsRange) {
  const auto& [field, set, low, high] = GetParam();
  for (const float value : {low, high, (low + high) / 2}) EXPECT_THAT(CheckWith(value), IsOk()) << value;
  for (const float value :
       {std::nextafter(low, -kInfinity), std::nextafter(high, kInfinity), std::numeric_limits<float>::max(),
        std::numeric_limits<float>::lowest(), kInfinity, -kInfinity, std::nanf("")}) {
    const std::string want = std::isfinite(value) ? absl::StrFormat("want %g..%g", low, high) : "want";
    EXPECT_THAT(CheckWith(value),
                StatusIs(absl::StatusCode::kInvalidArgument, AllOf(HasSubstr(field), HasSubstr(want))))
        << value;
  }
}

const float kLongest = static_cast<float>(kSampleShape.max_length) * wire::kMaxHidden;

INSTANTIATE_TEST_SUITE_P(
    FragmentCheck, FragmentRange,
    testing::Values(
        Range{"log_probs", [](Message* m, float v) { m->set_log_probs(4, v); }, wire::kMinLogProb, 0},
        Range{"values", [](Message* m, float v) { m->set_values(0, v); }, -wire::kMaxValue, wire::kMaxValue},
        Range{"rewards", [](Message* m, float v) { m->set_rewards(2, v); }, static_cast<float>(kMinStepReward),
              static_cast<float>(kMaxStepReward)},
        Range{"truncation_values", [](Message* m, float v) { m->set_truncation_values(0, v); }, -wire::kMaxValue,
              wire::kMaxValue},
        Range{"bootstrap_value", [](Message* m, float v) { m->set_bootstrap_value(v); }, -wire::kMaxValue,
              wire::kMaxValue},
        Range{"states", [](Message* m, float v) { m->set_states(0, v); }, -wire::kMaxHidden, wire::kMaxHidden},
        Range{"states", [](Message* m, float v) { m->set_states(1, v); }, -kLongest, kLongest},
        Range{"last_state", [](Message* m, float v) { m->set_last_state(0, v); }, -wire::kMaxHidden, wire::kMaxHidden},
        Range{"last_state", [](Message* m, float v) { m->set_last_state(1, v); }, -kLongest, kLongest}));

// Each is possible, but all together they are more than a game can give: returns, and with them the statistics of
// normalised values, would grow without bound.
TEST(FragmentCheck, RewardsAddUpToWhatAGameCanGive) {
  v1::FragmentMessage message;
  for (int t = 0; t < 22; ++t) message.add_rewards(1);
  message.add_rewards(0.9F);
  message.set_ends(std::string(30, '\0'));
  EXPECT_THAT(wire::CheckRewardSums(message), IsOk()) << "all achievements, and all health";
  message.add_rewards(0.1F);
  EXPECT_THAT(wire::CheckRewardSums(message),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("rewards: those up to step 23 add up to 23")));
  message.mutable_ends()->at(10) = static_cast<char>(StepEnd::kTerminated);
  EXPECT_THAT(wire::CheckRewardSums(message), IsOk()) << "of two episodes";
  message.clear_rewards();
  message.add_rewards(-0.9F);
  EXPECT_THAT(wire::CheckRewardSums(message), IsOk());
  message.add_rewards(-0.1F);
  EXPECT_THAT(wire::CheckRewardSums(message), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("add up to -1")));
}

TEST(FragmentCheck, CountsAreExactAsDoubles) {
  constexpr int64_t kMost = int64_t{1} << 52;
  for (const auto& [field, set] : std::vector<std::pair<std::string, std::function<void(Message*, int64_t)>>>{
           {"epoch", [](Message*m, int64_t count) { m->set_epoch(count); }},
           {"number", [](Message*m, int64_t count) { m->set_number(count); }},
           {"policy_version", [](Message*m, int64_t count) { m->set_policy_version(count); }}}) {
    Message message = wire::ToProto(SampleFragment(2, 0, 0, 0));
    EXPECT_THAT(Check(message), IsOk());
    set(&message, kMost);
    EXPECT_THAT(Check(message), IsOk());
    for (const int64_t count : {int64_t{-1}, kMost + 1}) {
      set(&message, count);
      EXPECT_THAT(Check(message), StatusIs(absl::StatusCode::kInvalidArgument,
                                           HasSubstr(absl::StrCat(field, ": ", count, ", want 0.."))));
    }
  }
}

TEST(FragmentCheck, TheSnapshotMustBeOfTheRunsEnvironment) {
  Message message = wire::ToProto(SampleFragment(2, 7, 40));
  message.set_snapshot("no envelope");
  EXPECT_THAT(Check(message),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("snapshot: 11 bytes without an envelope")));
  message.set_snapshot(SealSnapshot(kSampleShape.env_digest + 1, "game"));
  EXPECT_THAT(Check(message), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("other options")));
  message.set_snapshot(std::string(80 << 20, 's'));
  EXPECT_THAT(Check(message),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("snapshot: 83886080 bytes, want at most 114688")));
}

// The sample's episodes end at steps 1 and 3.
TEST(FragmentCheck, EpisodeLengthsMustMatchTheStepsPlayed) {
  const auto with_length = [](int episode, int64_t length) {
    Message message = wire::ToProto(SampleFragment(2, 7, 40));
    v1::EpisodeMessage* ended = message.mutable_episodes(episode);
    ended->set_length(length);
    for (int32_t& count : *ended->mutable_achievements()) count = 0;
    return Check(message);
  };
  const auto refused = [](const std::string& range) {
    return StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("want " + range));
  };
  EXPECT_THAT(with_length(0, 2), IsOk());
  EXPECT_THAT(with_length(0, 1), refused("2..10000"));
  EXPECT_THAT(with_length(0, 10000), IsOk());
  EXPECT_THAT(with_length(0, 10001), refused("2..10000"));
  EXPECT_THAT(with_length(0, int64_t{1} << 62), refused("2..10000"));
  EXPECT_THAT(with_length(1, 2), IsOk());
  EXPECT_THAT(with_length(1, 1), StatusIs(absl::StatusCode::kInvalidArgument,
                                          HasSubstr("length 1 of the one that ended at step 3, want 2..2")));
  EXPECT_THAT(with_length(1, 3), refused("2..2"));
}

TEST(FragmentCheck, EpisodeRewardsMustBePossible) {
  const auto with_reward = [](double reward) {
    v1::EpisodeMessage episode;
    episode.set_length(9);
    episode.set_reward(reward);
    return wire::CheckEpisode(episode, 1, 10);
  };
  EXPECT_THAT(with_reward(kMinEpisodeReward), IsOk());
  EXPECT_THAT(with_reward(kMaxEpisodeReward), IsOk());
  for (const double reward : {-0.90001, 22.00001, 1e300, -1e300, std::nan("")}) {
    EXPECT_THAT(with_reward(reward), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("want -0.9..22")))
        << reward;
  }
}

TEST(FragmentCheck, NoAchievementIsCountedMoreOftenThanThereWereSteps) {
  v1::EpisodeMessage episode;
  episode.set_length(9);
  episode.add_achievements(0);
  episode.add_achievements(9);
  EXPECT_THAT(wire::CheckEpisode(episode, 1, 10), IsOk());
  episode.set_achievements(0, 10);
  EXPECT_THAT(
      wire::CheckEpisode(episode, 1, 10),
      StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("achievements: 10 in an episode of 9 steps, want 0..9")));
  episode.set_achievements(0, -1);
  EXPECT_THAT(wire::CheckEpisode(episode, 1, 10),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("achievements: -1")));
}

TEST(FragmentCheck, EvaluationEpisodesMustFitTheEnvironmentsLength) {
  v1::EvaluationResult result = wire::ToProto({EndedEpisode(0, 500)});
  EXPECT_THAT(wire::FromProto(result, 500), IsOk());
  EXPECT_THAT(wire::FromProto(result, 499), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("want 1..499")));
}

// The state of two LSTMs of size two: h and c of the first, then h and c of the second.
TEST(FragmentCheck, OutputsOfEachLstmAreBounded) {
  google::protobuf::RepeatedField<float> states;
  for (const float value : {1, -1, 100, -100, 0, 1, 99, 3}) states.Add(value);
  EXPECT_THAT(wire::CheckStates("states", states, 2, 100), IsOk());
  states[4] = 2;
  EXPECT_THAT(wire::CheckStates("states", states, 2, 100),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("states: 2 at 4, want -1.001..1.001")));
}

TEST(ClampPredictions, KeepsTheNumbersOfADivergingAgentWithinTheirRanges) {
  Fragment fragment;
  fragment.log_probs = {-200, -2};
  fragment.values = {1e9F, -1e9F, 3};
  fragment.truncation_values = {1e9F};
  fragment.bootstrap_value = -1e9F;
  wire::ClampPredictions(&fragment);
  EXPECT_THAT(fragment.log_probs, testing::ElementsAre(wire::kMinLogProb, -2));
  EXPECT_THAT(fragment.values, testing::ElementsAre(wire::kMaxValue, -wire::kMaxValue, 3));
  EXPECT_THAT(fragment.truncation_values, testing::ElementsAre(wire::kMaxValue));
  EXPECT_EQ(fragment.bootstrap_value, -wire::kMaxValue);
}

}  // namespace fragment_check_test
}  // namespace craftfleet
