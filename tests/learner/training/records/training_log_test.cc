#include "learner/training/records/training_log.h"

#include <algorithm>
#include <atomic>
#include <map>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include <absl/strings/str_cat.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/fakes/file_size_limit.h"
#include "tests/fakes/wait_until.h"
#include "tests/learner/run/read_events.h"
#include "tests/learner/run/run_samples.h"
#include "tests/learner/training/records/open_run.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;

constexpr char kEvents[] = "events.out.tfevents.craftfleet";

// A fragment with the end of an episode that unlocked `achievements`.
Fragment Ending(int64_t length, const std::vector<int>& achievements = {}) {
  Episode episode;
  episode.length = length;
  episode.reward = static_cast<double>(achievements.size());
  for (const int i : achievements) episode.achievements[i] = 1;
  Fragment fragment;
  fragment.episodes = {episode};
  return fragment;
}

class TrainingLogTest : public OpenRun {
 protected:
  // The values of the last event, by tag.
  std::map<std::string, float> LastPoint() const {
    std::map<std::string, float> values;
    const std::vector<v1::Event> events = ReadEvents(JoinPath(logdir_, kEvents));
    for (const auto& value : events.back().summary().value()) values[value.tag()] = value.simple_value();
    return values;
  }
  int64_t StatsLines() const {
    const std::string text = Text("stats.jsonl");
    return std::count(text.begin(), text.end(), '\n');
  }

  StopFlag stop_;
  DiskWait disk_{&stop_, &clock_, absl::ZeroDuration()};
};

TEST_F(TrainingLogTest, WritesHowOldTheWeightsWere) {
  TrainingLog log(run_.get(), &disk_);
  log.AddStaleness(4096, {0, 0.5, 2}, 7);
  log.Flush();
  EXPECT_EQ(LastPoint(), (std::map<std::string, float>{{"rollout/staleness_min", 0},
                                                       {"rollout/staleness_mean", 0.5F},
                                                       {"rollout/staleness_max", 2},
                                                       {"rollout/fragments_dropped", 7}}));
}

TEST_F(TrainingLogTest, WritesAPointOfEveryCurve) {
  TrainingLog log(run_.get(), &disk_);
  UpdateStats stats;
  stats.policy_loss = 1;
  stats.value_loss = 2;
  stats.entropy = 3;
  stats.clip_fraction = 4;
  stats.gradient_norm = 5;
  stats.approx_kl = 6;
  stats.explained_variance = 7;
  log.AddIteration(4096, {Ending(100, {0, 5}), Ending(300, {5})}, stats, 1234);
  log.Flush();
  std::map<std::string, float> wanted = {
      {"train/policy_loss", 1},
      {"train/value_loss", 2},
      {"train/entropy", 3},
      {"train/clip_fraction", 4},
      {"train/gradient_norm", 5},
      {"train/approx_kl", 6},
      {"train/explained_variance", 7},
      {"rollout/reward", 1.5F},
      {"rollout/length", 200},
      {"rollout/crafter_score", static_cast<float>(run_->score().Score())},
      {"rollout/achievements_unlocked", 2},
      {"rollout/episodes", 2},
      {"time/steps_per_second", 1234},
  };
  for (int i = 0; i < kNumAchievements; ++i) {
    wanted[absl::StrCat("success_rate/", kAchievementNames[i])] = i == 0 ? 50.0F : i == 5 ? 100.0F : 0.0F;
  }
  EXPECT_EQ(LastPoint(), wanted);
  EXPECT_EQ(wanted.count("success_rate/collect_coal"), 1u);
  EXPECT_EQ(ReadEvents(JoinPath(logdir_, kEvents)).back().step(), 4096);
}

TEST_F(TrainingLogTest, WritesImportanceWeightsOfUpdatesThatUseThem) {
  TrainingLog log(run_.get(), &disk_);
  UpdateStats stats;
  log.AddIteration(4096, {Ending(100)}, stats, 0);
  log.Flush();
  EXPECT_EQ(LastPoint().count("train/importance_weight_mean"), 0u);
  stats.importance = {1.25, 0.5, 3};
  log.AddIteration(8192, {Ending(100)}, stats, 0);
  log.Flush();
  EXPECT_EQ(LastPoint()["train/importance_weight_mean"], 1.25F);
  EXPECT_EQ(LastPoint()["train/importance_weight_min"], 0.5F);
  EXPECT_EQ(LastPoint()["train/importance_weight_max"], 3.0F);
}

TEST_F(TrainingLogTest, WritesEpisodesInTheOrderOfTheFragments) {
  TrainingLog log(run_.get(), &disk_);
  log.AddIteration(1, {Ending(30), Ending(10), Fragment(), Ending(20)}, {}, 0);
  EXPECT_EQ(Text("stats.jsonl"), "") << "before Flush";
  log.Flush();
  const Episode first = Ending(30).episodes[0], second = Ending(10).episodes[0], third = Ending(20).episodes[0];
  EXPECT_EQ(Text("stats.jsonl"), FormatStatsLine(first) + FormatStatsLine(second) + FormatStatsLine(third));
}

TEST_F(TrainingLogTest, SuccessRatesCoverAllEpisodesOfTheRun) {
  TrainingLog log(run_.get(), &disk_);
  log.AddIteration(1, {Ending(10, {3})}, {}, 0);
  log.AddIteration(2, {Ending(10), Ending(10), Ending(10)}, {}, 0);
  log.Flush();
  EXPECT_EQ(LastPoint()[absl::StrCat("success_rate/", kAchievementNames[3])], 25);
}

TEST_F(TrainingLogTest, OnAFullDiskLogsWaitAndTrainingContinues) {
  TrainingLog log(run_.get(), &disk_);
  testing::internal::CaptureStderr();
  {
    const FileSizeLimit limit(400);
    log.AddIteration(1, {Ending(10)}, {}, 0);
    log.Flush();
  }
  EXPECT_THAT(testing::internal::GetCapturedStderr(),
              HasSubstr("bytes of logs are waiting for space; free space on that disk"));
  EXPECT_EQ(StatsLines(), 0);
  log.AddIteration(2, {Ending(20)}, {}, 0);
  log.Flush();
  EXPECT_EQ(StatsLines(), 2);
  EXPECT_EQ(run_->waiting_bytes(), 0);
}

TEST_F(TrainingLogTest, WithTooManyWaitingLogsTrainingWaits) {
  TrainingLog log(run_.get(), &disk_, /*max_waiting_bytes=*/100);
  auto limit = std::make_unique<FileSizeLimit>(400);
  std::atomic<bool> flushed{false};
  std::thread training([&] {
    log.AddIteration(1, {Ending(10)}, {}, 0);
    log.Flush();
    flushed = true;
  });
  EXPECT_FALSE(WaitUntil([&] { return flushed.load(); }, absl::Milliseconds(100)));
  limit.reset();
  training.join();
  EXPECT_EQ(StatsLines(), 1);
}

TEST_F(TrainingLogTest, AStopEndsTheWaitForSpace) {
  TrainingLog log(run_.get(), &disk_, /*max_waiting_bytes=*/100);
  const FileSizeLimit limit(400);
  log.AddIteration(1, {Ending(10)}, {}, 0);
  stop_.Set();
  log.Flush();
  EXPECT_GT(run_->waiting_bytes(), 100);
}

TEST_F(TrainingLogTest, ATakeoverEndsTheWaitForSpace) {
  TrainingLog log(run_.get(), &disk_, /*max_waiting_bytes=*/100);
  log.AddIteration(1, {Ending(10)}, {}, 0);
  TakeOver();
  testing::internal::CaptureStderr();
  log.Flush();
  EXPECT_EQ(testing::internal::GetCapturedStderr(), "") << "its disk is not to blame";
  EXPECT_GT(run_->waiting_bytes(), 100);
}

}  // namespace
}  // namespace craftfleet
