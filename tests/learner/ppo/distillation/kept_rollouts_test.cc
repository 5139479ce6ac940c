#include "learner/ppo/distillation/kept_rollouts.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/agent/golden_agent.h"

namespace craftfleet {
namespace kept_rollouts_test {

using testing::ElementsAre;
using testing::HasSubstr;

constexpr int kLanes = 2;
constexpr int kFrameBytes = 3;
constexpr int kMemory = 2;

// A rollout with what it points to. `ends` and `unlocks` have a character for each row: '.' is no.
struct Sample {
  Sample(const std::string& ends, const std::string& unlocks, char first_frame) {
    for (size_t i = 0; i < ends.size(); ++i) {
      frames.append(kFrameBytes, static_cast<char>(first_frame + i));
      memories.insert(memories.end(), {i < 2 ? 0.0F : 0.5F, i < 5 ? 0.0F : 1.0F});
    }
    for (size_t i = 0; i < ends.size(); ++i) {
      rollout.frames.push_back(reinterpret_cast<const uint8_t*>(&frames[i * kFrameBytes]));
      rollout.states.push_back(&memories[i * kMemory]);
      rollout.actions.push_back(static_cast<Action>(i));
      rollout.returns.push_back(static_cast<float>(first_frame) + static_cast<float>(i));
      rollout.rewards.push_back(unlocks[i] == '.' ? 0.1F : 0.9F);
      rollout.ends.push_back(ends[i] == '.' ? StepEnd::kNone : StepEnd::kTerminated);
    }
  }
  Sample(const Sample&) = delete;
  Sample& operator=(const Sample&) = delete;

  std::string frames;
  std::vector<float> memories;
  Rollout rollout;
};

KeptRollouts Kept() { return {kLanes, kFrameBytes, kMemory}; }

std::vector<std::vector<int>> RowsOf(const KeptRollouts& kept) {
  std::vector<std::vector<int>> rows;
  for (const KeptEpisode& episode : kept.Episodes()) rows.push_back(episode.rows);
  return rows;
}

const char kGolden[] = "achievement_distillation.json";

TEST(Goals, AnEpisodesGoalsMatchTheGolden) {
  const nlohmann::json golden = ReadGolden(kGolden)["goals"];
  ASSERT_GE(golden.size(), 3U);
  for (const nlohmann::json& episode : golden) {
    const auto unlocked = episode["unlocked"].get<std::vector<uint8_t>>();
    const std::vector<int> goals = GoalSteps(unlocked);
    EXPECT_EQ(goals, episode["goals"].get<std::vector<int>>());
    for (size_t t = 0; t < unlocked.size(); ++t) {
      const FramePair next = NextGoal(goals, static_cast<int>(unlocked.size()), static_cast<int>(t));
      EXPECT_EQ(next.before, episode["anchors"][t][0].get<int>()) << t;
      EXPECT_EQ(next.after, episode["anchors"][t][1].get<int>()) << t;
    }
  }
}

TEST(Goals, WholeEpisodesMatchTheGolden) {
  const nlohmann::json golden = ReadGolden(kGolden)["episodes"]["lanes"];
  ASSERT_GE(golden.size(), 3U);
  for (const nlohmann::json& lane : golden) {
    std::vector<StepRange> expected;
    for (const nlohmann::json& range : lane["episodes"]) expected.push_back({range[0], range[1]});
    EXPECT_EQ(WholeEpisodes(lane["is_start"].get<std::vector<uint8_t>>()), expected);
  }
}

TEST(KeptRollouts, EpisodesRunOnFromRolloutToRollout) {
  KeptRollouts kept = Kept();
  // Lane 0 begins an episode with its third step, which ends in the next rollout.
  kept.Add(0, Sample(".x......", "...u....", 'a').rollout);
  kept.Add(1, Sample(".x......", "uu......", 'A').rollout);
  EXPECT_EQ(RowsOf(kept), (std::vector<std::vector<int>>{{2, 3, 8, 9}}));
  EXPECT_THAT(kept.Episodes()[0].goals, ElementsAre(1, 2)) << "the last step's unlock is no goal";
  EXPECT_EQ(kept.frame(3)[0], 'd');
  EXPECT_EQ(kept.frame(8)[0], 'A');
  EXPECT_EQ(kept.return_of(9), 'A' + 1);
  EXPECT_EQ(kept.action(9), Action::kMoveLeft);
  EXPECT_EQ(kept.rows(), 16);
}

TEST(KeptRollouts, EpisodesWithoutAchievementTakeNoPart) {
  KeptRollouts kept = Kept();
  kept.Add(0, Sample("x..xx..x", ".......u", 'a').rollout);
  EXPECT_TRUE(kept.Episodes().empty());
}

TEST(KeptRollouts, TheFirstEpisodeAfterAPhaseIsWholeIfItBeganThere) {
  KeptRollouts kept = Kept();
  kept.Add(0, Sample("...x....", "........", 'a').rollout);
  kept.Clear();
  EXPECT_EQ(kept.rows(), 0);
  kept.Add(1, Sample("..x...x.", "u...u...", 'a').rollout);
  EXPECT_EQ(RowsOf(kept), (std::vector<std::vector<int>>{{0, 1, 2}})) << "lane 1 was in an episode";
}

TEST(KeptRollouts, AnIterationThatIsPlayedAgainReplacesItsRollout) {
  KeptRollouts kept = Kept();
  kept.Add(3, Sample("........", "........", 'a').rollout);
  kept.Add(4, Sample("........", "........", 'i').rollout);
  kept.Add(4, Sample("........", "........", 'I').rollout);
  EXPECT_EQ(kept.rows(), 16);
  EXPECT_EQ(kept.frame(8)[0], 'I');
  kept.DropFrom(4);
  EXPECT_EQ(kept.rows(), 8);
}

TEST(KeptRollouts, MemoriesAreThoseOfTheRollout) {
  KeptRollouts kept = Kept();
  kept.Add(0, Sample("........", "........", 'a').rollout);
  EXPECT_EQ(kept.memory(1), nullptr);
  EXPECT_EQ(kept.memory(2)[0], 0.5F);
  EXPECT_EQ(kept.memory(2), kept.memory(4)) << "kept once";
  EXPECT_EQ(kept.memory(7)[1], 1);
}

TEST(KeptRollouts, LoadedOnesEqualTheSavedOnes) {
  KeptRollouts kept = Kept();
  kept.Add(0, Sample("...x...x", "........", 'a').rollout);
  kept.Clear();
  kept.Add(1, Sample(".x......", "uu......", 'a').rollout);
  kept.Add(2, Sample(".x......", "uu......", 'A').rollout);
  SafeTensors file;
  kept.Save(&file);
  const std::string bytes = WriteSafetensors(file);
  KeptRollouts loaded = Kept();
  ASSERT_TRUE(loaded.Load(*ReadSafetensors(bytes)).ok());
  SafeTensors again;
  loaded.Save(&again);
  EXPECT_TRUE(WriteSafetensors(again) == bytes);
  EXPECT_EQ(RowsOf(loaded), RowsOf(kept));
  EXPECT_EQ(loaded.memory(13)[1], 1);
  loaded.DropFrom(2);
  EXPECT_EQ(loaded.rows(), 8) << "iterations are known";
}

TEST(KeptRollouts, LoadRefusesWhatIsNotTheRunsAndKeepsWhatItHas) {
  KeptRollouts kept = Kept();
  kept.Add(1, Sample("........", "........", 'a').rollout);
  SafeTensors file;
  kept.Save(&file);
  const auto error = [&](const SafeTensors& changed) { return std::string(kept.Load(changed).message()); };
  SafeTensors missing = file;
  missing.tensors.pop_back();
  EXPECT_THAT(error(missing), HasSubstr("kept.0.steps"));
  SafeTensors shorter = file;
  shorter.tensors[2].data.remove_suffix(1);
  EXPECT_THAT(error(shorter), HasSubstr("kept.0.frames"));
  SafeTensors lanes = file;
  lanes.metadata["kept.at_start"] = "0";
  EXPECT_THAT(error(lanes), HasSubstr("does not have 2 lanes"));
  SafeTensors count = file;
  count.metadata["kept.count"] = "many";
  EXPECT_THAT(error(count), HasSubstr("kept.count"));
  EXPECT_EQ(kept.rows(), 8);
}

}  // namespace kept_rollouts_test
}  // namespace craftfleet
