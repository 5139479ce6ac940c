#include "learner/training/records/training_status.h"

#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/config/config.h"
#include "tests/fakes/metric_of.h"
#include "tests/learner/training/records/open_run.h"

namespace craftfleet {
namespace {

class TrainingStatusTest : public OpenRun {
 protected:
  TrainingStatusTest() {
    config_.set_lanes(8);
    config_.set_steps(5000);
    config_.mutable_ppo()->set_rollout_steps(1000);
  }
  v1::StatusReply Fill() const {
    v1::StatusReply reply;
    status_.Fill(meter_, absl::Seconds(7), &reply);
    return reply;
  }
  double Metric(const std::string& name) const { return MetricOf(Fill(), name); }
  double Rate() const { return Fill().summary().steps_per_second(); }
  void RunIteration(absl::Duration time) {
    status_.OnIterationBegin();
    clock_.Advance(time);
    EndIteration();
  }
  void EndIteration() { status_.OnIterationEnd(*run_, Fragment(), /*frame_size=*/64); }

  v1::RunConfig config_ = DefaultRunConfig();
  TrainerCounters counters_;
  ActivityMeter meter_{&clock_, Activity::kOther};
  TrainingStatus status_{config_, &counters_, &clock_};
};

TEST_F(TrainingStatusTest, ShowsCurrentProgress) {
  counters_.iteration = 3;
  counters_.env_steps = 3000;
  counters_.policy_version = 4;
  EXPECT_EQ(Metric("iteration"), 3);
  EXPECT_EQ(Metric("env_steps"), 3000);
  EXPECT_EQ(Metric("env_steps_goal"), 5000);
  EXPECT_EQ(Metric("checkpoint_age"), 7);
  EXPECT_EQ(Fill().summary().policy_version(), 4);
  EXPECT_EQ(Fill().summary().lanes(), 8);
  EXPECT_EQ(Fill().summary().threads(), 1);
  counters_.env_steps = 4000;
  EXPECT_EQ(Metric("env_steps"), 4000);
}

TEST_F(TrainingStatusTest, ShowsTheScoreOfFinishedIterations) {
  Episode episode;
  episode.length = 120;
  episode.reward = 2.5;
  episode.achievements[3] = 1;
  run_->AddEpisodes({episode});
  EXPECT_EQ(Metric("episodes"), 0);
  status_.OnStart(*run_);
  EXPECT_EQ(Metric("episodes"), 1) << "from an earlier start";
  run_->AddEpisodes({episode});
  EXPECT_EQ(Metric("episodes"), 1) << "its iteration is not finished";
  RunIteration(absl::Seconds(1));
  EXPECT_EQ(Metric("episodes"), 2);
  EXPECT_EQ(Metric("reward"), 2.5);
  EXPECT_EQ(Metric("episode_length"), 120);
  EXPECT_EQ(Metric("crafter_score"), run_->score().Score());
  EXPECT_EQ(Metric("achievements_unlocked"), 1);
}

TEST_F(TrainingStatusTest, TheRateIsOfTheLastIterationUnlessThisOneTakesLonger) {
  EXPECT_EQ(Rate(), 0);
  status_.OnIterationBegin();
  clock_.Advance(absl::Seconds(1));
  EXPECT_EQ(Rate(), 0) << "none has ended";
  EndIteration();
  EXPECT_EQ(Rate(), 1000);
  RunIteration(absl::Seconds(2));
  EXPECT_EQ(Rate(), 500);
  status_.OnIterationBegin();
  clock_.Advance(absl::Seconds(1));
  EXPECT_EQ(Rate(), 500);
  clock_.Advance(absl::Seconds(4));
  EXPECT_EQ(Rate(), 200);
}

TEST_F(TrainingStatusTest, ShowsHowOldTheWeightsOfTheLastUpdateWere) {
  EXPECT_EQ(Metric("staleness_max"), 0);
  std::vector<Fragment> fragments(4);
  for (int i = 0; i < 4; ++i) fragments[i].policy_version = i == 0 ? 4 : 6;
  status_.OnUpdate(StalenessOf(fragments, 7));
  EXPECT_EQ(Metric("staleness_min"), 1);
  EXPECT_EQ(Metric("staleness_mean"), 1.5);
  EXPECT_EQ(Metric("staleness_max"), 3);
}

TEST_F(TrainingStatusTest, CountsUndoneUpdates) {
  EXPECT_EQ(Metric("updates_undone"), 0);
  status_.OnUpdateUndone();
  status_.OnUpdateUndone();
  EXPECT_EQ(Metric("updates_undone"), 2);
}

}  // namespace
}  // namespace craftfleet
