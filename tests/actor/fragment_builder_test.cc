#include "actor/fragment_builder.h"

#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/wire/fragment_check.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/wire_samples.h"

namespace craftfleet {
namespace {

// Appends the steps of SampleFragment(lane, ...) in the order in which an actor gets them.
Fragment Build(FragmentBuilder* builder, int lane, int64_t number) {
  const Fragment sample = SampleFragment(lane, number, 9, 3);
  builder->Start(3, lane, number, 9, kSampleShape.steps, kSampleShape.frame_bytes);
  builder->AddState(sample.states);
  size_t ended = 0;
  for (int t = 0; t < kSampleShape.steps; ++t) {
    EXPECT_EQ(builder->size(), t);
    builder->Append(absl::string_view(sample.frames).substr(t * kSampleShape.frame_bytes, kSampleShape.frame_bytes),
                    static_cast<Action>(sample.actions[t]), sample.log_probs[t], sample.values[t], sample.rewards[t],
                    sample.ends[t]);
    if (sample.ends[t] == StepEnd::kNone) continue;
    Episode episode = sample.episodes[ended++];
    episode.step = 0;  // as sent by an environment server
    builder->AddEpisode(episode);
    if (sample.ends[t] == StepEnd::kTruncated) builder->AddTruncationValue(sample.truncation_values[0]);
  }
  return builder->Finish(sample.bootstrap_value, sample.snapshot);
}

TEST(FragmentBuilder, AssemblesSteps) {
  FragmentBuilder builder;
  ExpectSameFragments(Build(&builder, 1, 4), SampleFragment(1, 4, 9, 3));
}

TEST(FragmentBuilder, NothingRemainsOfAnEarlierFragment) {
  FragmentBuilder builder;
  Build(&builder, 1, 4);
  builder.Start(3, 1, 5, 9, kSampleShape.steps, kSampleShape.frame_bytes);
  builder.AddState({1, 2});
  builder.Append("left behind!", Action::kDo, 0, 0, 0, StepEnd::kTerminated);  // then the environment server failed
  builder.AddEpisode(EndedEpisode(0, 1));
  ExpectSameFragments(Build(&builder, 2, 0), SampleFragment(2, 0, 9, 3));
}

TEST(FragmentBuilder, NumbersOfAnAgentThatDivergesStayWithinTheirRanges) {
  FragmentBuilder builder;
  builder.Start(3, 1, 5, 9, 2, 1);
  builder.Append("f", Action::kDo, -200, 1e9F, 0, StepEnd::kNone);
  builder.Append("f", Action::kDo, -2, -1e9F, 0, StepEnd::kTruncated);
  builder.AddTruncationValue(1e9F);
  const Fragment fragment = builder.Finish(-1e9F, {});
  EXPECT_THAT(fragment.log_probs, testing::ElementsAre(wire::kMinLogProb, -2));
  EXPECT_THAT(fragment.values, testing::ElementsAre(wire::kMaxValue, -wire::kMaxValue));
  EXPECT_THAT(fragment.truncation_values, testing::ElementsAre(wire::kMaxValue));
  EXPECT_EQ(fragment.bootstrap_value, -wire::kMaxValue);
}

}  // namespace
}  // namespace craftfleet
