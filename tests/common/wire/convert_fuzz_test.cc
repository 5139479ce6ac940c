// Damaged messages are refused, or yield data of the right shape.

#include <cmath>
#include <random>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/wire/convert.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/wire_samples.h"

namespace craftfleet {
namespace {

constexpr int kInputs = 20000;
constexpr unsigned kSeed = 20240131;

// Changes, removes, duplicates or inserts a few bytes.
std::string Mutate(std::string bytes, std::mt19937* random) {
  const auto below = [random](size_t n) { return static_cast<size_t>((*random)() % n); };
  for (size_t edits = 1 + below(4); edits > 0 && !bytes.empty(); --edits) {
    const size_t at = below(bytes.size());
    switch (below(6)) {
      case 0:
        bytes[at] = static_cast<char>(below(256));
        break;
      case 1:
        bytes[at] = static_cast<char>(bytes[at] ^ (1 << below(8)));
        break;
      case 2:
        bytes.erase(at, 1 + below(8));
        break;
      case 3:
        bytes.insert(at, bytes.substr(below(bytes.size()), 1 + below(16)));
        break;
      case 4:
        bytes.insert(at, 1 + below(4), static_cast<char>(below(256)));
        break;
      default:
        bytes.resize(at);
    }
  }
  return bytes;
}

bool AllFinite(const std::vector<float>& values) {
  for (const float value : values) {
    if (!std::isfinite(value)) return false;
  }
  return true;
}

// Checks that there is a valid episode for each end.
void ExpectSoundEpisodes(const std::vector<StepEnd>& ends, const std::vector<Episode>& episodes, size_t truncated) {
  size_t ended = 0;
  size_t cut = 0;
  for (const StepEnd end : ends) {
    ASSERT_LE(static_cast<int>(end), 2);
    ended += end != StepEnd::kNone ? 1 : 0;
    cut += end == StepEnd::kTruncated ? 1 : 0;
  }
  ASSERT_EQ(episodes.size(), ended);
  ASSERT_EQ(truncated, cut);
  for (const Episode& episode : episodes) {
    ASSERT_GE(episode.length, 1);
    ASSERT_TRUE(std::isfinite(episode.reward));
    ASSERT_GE(episode.step, 0);
    ASSERT_LT(episode.step, static_cast<int>(ends.size()));
  }
}

void ExpectShape(const Fragment& fragment) {
  const auto steps = static_cast<size_t>(kSampleShape.steps);
  ASSERT_GE(fragment.lane, 0);
  ASSERT_LT(fragment.lane, kSampleShape.lanes);
  ASSERT_EQ(fragment.frames.size(), steps * kSampleShape.frame_bytes);
  ASSERT_EQ(fragment.actions.size(), steps);
  for (const char action : fragment.actions) ASSERT_LT(static_cast<unsigned char>(action), kNumActions);
  ASSERT_EQ(fragment.log_probs.size(), steps);
  ASSERT_EQ(fragment.values.size(), steps);
  ASSERT_EQ(fragment.rewards.size(), steps);
  ASSERT_EQ(fragment.ends.size(), steps);
  ASSERT_TRUE(AllFinite(fragment.log_probs) && AllFinite(fragment.values) && AllFinite(fragment.rewards));
  ASSERT_TRUE(AllFinite(fragment.truncation_values) && std::isfinite(fragment.bootstrap_value));
  ASSERT_EQ(fragment.states.size(), kSampleShape.state_size);
  ASSERT_EQ(fragment.snapshot.state.size(), kSampleShape.state_size);
  ASSERT_TRUE(AllFinite(fragment.states) && AllFinite(fragment.snapshot.state));
  ASSERT_FALSE(fragment.snapshot.game.empty());
  ExpectSoundEpisodes(fragment.ends, fragment.episodes, fragment.truncation_values.size());
}

TEST(ConvertFuzz, DamagedFragmentsAreRefusedOrWellFormed) {
  std::mt19937 random(kSeed);
  const std::string good = wire::ToProto(SampleFragment(1, 2, 3)).SerializeAsString();
  int parsed = 0;
  int accepted = 0;
  for (int i = 0; i < kInputs; ++i) {
    SCOPED_TRACE(testing::Message() << "seed " << kSeed << ", input " << i);
    v1::FragmentMessage message;
    if (!message.ParseFromString(Mutate(good, &random))) continue;
    ++parsed;
    const auto fragment = wire::FromProto(&message, kSampleShape);
    if (!fragment.ok()) {
      ASSERT_THAT(fragment, StatusIs(absl::StatusCode::kInvalidArgument, testing::Not(testing::IsEmpty())));
      continue;
    }
    ++accepted;
    ASSERT_NO_FATAL_FAILURE(ExpectShape(*fragment));
  }
  // The inputs cover all three outcomes.
  EXPECT_GT(kInputs - parsed, kInputs / 50);
  EXPECT_GT(parsed - accepted, kInputs / 50);
  EXPECT_GT(accepted, kInputs / 50);
}

TEST(ConvertFuzz, DamagedRepliesAreRefusedOrWellFormed) {
  std::mt19937 random(kSeed);
  StepBatch sent = SampleStepBatch();
  v1::PlayReply good;
  wire::ToProto(&sent, &good);
  const std::string bytes = good.SerializeAsString();
  int accepted = 0;
  int refused = 0;
  StepBatch batch;  // reused, as EnvClient does
  for (int i = 0; i < kInputs; ++i) {
    SCOPED_TRACE(testing::Message() << "seed " << kSeed << ", input " << i);
    v1::PlayReply message;
    if (!message.ParseFromString(Mutate(bytes, &random))) continue;
    const absl::Status status = wire::FromProto(&message, 3, 12, wire::kMaxEpisodeLength, &batch);
    if (!status.ok()) {
      ASSERT_EQ(status.code(), absl::StatusCode::kInvalidArgument);
      ++refused;
      continue;
    }
    ++accepted;
    ASSERT_EQ(batch.frames.size(), 36);
    ASSERT_EQ(batch.rewards.size(), 3);
    ASSERT_TRUE(AllFinite(batch.rewards));
    ASSERT_EQ(batch.ends.size(), 3);
    ASSERT_TRUE(batch.snapshots.empty() || batch.snapshots.size() == 3);
    ASSERT_NO_FATAL_FAILURE(ExpectSoundEpisodes(batch.ends, batch.episodes, batch.last_frames.size() / 12));
  }
  EXPECT_GT(refused, kInputs / 50);
  EXPECT_GT(accepted, kInputs / 50);
}

}  // namespace
}  // namespace craftfleet
