// Sample fragments and replies for tests.

#pragma once

#include <algorithm>
#include <cstdint>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "common/base/types.h"
#include "common/io/snapshot_envelope.h"
#include "common/wire/convert.h"

namespace craftfleet {

inline constexpr wire::FragmentShape kSampleShape = {3, 5, 12, 2, 1};  // lanes, steps, frame bytes, state size, states

inline Episode EndedEpisode(int step, int64_t length) {
  Episode episode;
  episode.step = step;
  episode.length = length;
  episode.reward = 2.1 - 0.1 * step;
  for (int i = 0; i < kNumAchievements; ++i) {
    episode.achievements[i] = static_cast<int>(std::min<int64_t>((i * 7 + step) % 5, length));
  }
  return episode;
}

// `game` in an envelope of kSampleShape's environment.
inline std::string SampleSnapshot(const std::string& game) { return SealSnapshot(kSampleShape.env_digest, game); }

// A fragment of kSampleShape with a death at step 1 and a truncation at step 3.
inline Fragment SampleFragment(int lane, int64_t number, int64_t policy_version, int64_t epoch = 1) {
  Fragment fragment;
  fragment.epoch = epoch;
  fragment.lane = lane;
  fragment.number = number;
  fragment.policy_version = policy_version;
  for (int i = 0; i < kSampleShape.steps * kSampleShape.frame_bytes; ++i) {
    fragment.frames.push_back(static_cast<char>(i * 5 + lane));
  }
  fragment.actions = std::string({0, 16, 5, 1, 9});
  fragment.log_probs = {-0.5F, -2.25F, -1e-7F, 0, -8};
  fragment.values = {1.5F, 0, -2, 3, 4};
  fragment.rewards = {0, -0.1F, 1, 0, 0.1F};
  fragment.ends = {StepEnd::kNone, StepEnd::kTerminated, StepEnd::kNone, StepEnd::kTruncated, StepEnd::kNone};
  fragment.truncation_values = {0.75F};
  fragment.bootstrap_value = -1.25F;
  fragment.episodes = {EndedEpisode(1, 166), EndedEpisode(3, 2)};
  fragment.states = {0.25F, -static_cast<float>(lane)};
  fragment.snapshot.game =
      SampleSnapshot("the game of lane " + std::to_string(lane) + std::string("\0after", 6) + std::to_string(number));
  fragment.snapshot.state = {-0.5F, static_cast<float>(number)};
  return fragment;
}

// Three rows with frames of 12 bytes: the first terminated, the last was truncated.
inline StepBatch SampleStepBatch() {
  StepBatch batch;
  batch.rewards = {-0.1F, 0, 1.1F};
  batch.ends = {StepEnd::kTerminated, StepEnd::kNone, StepEnd::kTruncated};
  batch.frames = "frame of l.1frame of l.2frame of l.3";
  batch.last_frames = "last of l. 3";
  batch.episodes = {EndedEpisode(0, 9), EndedEpisode(0, 10000)};
  batch.snapshots = {"one", std::string("t\0o", 3), "three"};
  return batch;
}

// A moment with a frame of 12 bytes and a picture of 27.
inline Moment SampleMoment(int number) {
  Moment moment;
  moment.frame = "frame of m." + std::to_string(number);
  moment.picture = "a larger picture of moment " + std::to_string(number);
  moment.picture.resize(27);
  moment.semantic.assign(kWorldSize * kWorldSize, static_cast<char>(1 + number % 18));
  moment.player_x = 63 - number;
  moment.player_y = number;
  for (int i = 0; i < kNumItems; ++i) moment.inventory[i] = (i + number) % 10;
  for (int i = 0; i < kNumAchievements; ++i) moment.achievements[i] = i * number;
  return moment;
}

inline void ExpectSameMoments(const std::vector<Moment>& actual, const std::vector<Moment>& wanted) {
  ASSERT_EQ(actual.size(), wanted.size());
  for (size_t i = 0; i < wanted.size(); ++i) {
    EXPECT_EQ(actual[i].frame, wanted[i].frame);
    EXPECT_EQ(actual[i].picture, wanted[i].picture);
    EXPECT_EQ(actual[i].semantic, wanted[i].semantic);
    EXPECT_EQ(actual[i].player_x, wanted[i].player_x);
    EXPECT_EQ(actual[i].player_y, wanted[i].player_y);
    EXPECT_EQ(actual[i].inventory, wanted[i].inventory);
    EXPECT_EQ(actual[i].achievements, wanted[i].achievements);
  }
}

inline void ExpectSameEpisodes(const std::vector<Episode>& actual, const std::vector<Episode>& wanted) {
  ASSERT_EQ(actual.size(), wanted.size());
  for (size_t i = 0; i < wanted.size(); ++i) {
    EXPECT_EQ(actual[i].step, wanted[i].step);
    EXPECT_EQ(actual[i].length, wanted[i].length);
    EXPECT_EQ(actual[i].reward, wanted[i].reward);
    EXPECT_EQ(actual[i].achievements, wanted[i].achievements);
  }
}

inline void ExpectSameFragments(const Fragment& actual, const Fragment& wanted) {
  EXPECT_EQ(actual.epoch, wanted.epoch);
  EXPECT_EQ(actual.lane, wanted.lane);
  EXPECT_EQ(actual.number, wanted.number);
  EXPECT_EQ(actual.policy_version, wanted.policy_version);
  EXPECT_EQ(actual.frames, wanted.frames);
  EXPECT_EQ(actual.actions, wanted.actions);
  EXPECT_EQ(actual.log_probs, wanted.log_probs);
  EXPECT_EQ(actual.values, wanted.values);
  EXPECT_EQ(actual.rewards, wanted.rewards);
  EXPECT_EQ(actual.ends, wanted.ends);
  EXPECT_EQ(actual.truncation_values, wanted.truncation_values);
  EXPECT_EQ(actual.bootstrap_value, wanted.bootstrap_value);
  ExpectSameEpisodes(actual.episodes, wanted.episodes);
  EXPECT_EQ(actual.states, wanted.states);
  EXPECT_EQ(actual.snapshot.game, wanted.snapshot.game);
  EXPECT_EQ(actual.snapshot.state, wanted.snapshot.state);
}

}  // namespace craftfleet
