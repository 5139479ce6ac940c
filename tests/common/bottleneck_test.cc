#include "common/bottleneck.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace craftfleet {
namespace {

using testing::HasSubstr;

// A fleet whose learner waits for `intake` of 10 s and whose actors play as told.
FleetView Fleet(double intake, double environment, double wire, double inference, double permits) {
  FleetView view;
  view.actors = 2;
  view.env_servers = 2;
  view.steps_per_second = 1000;
  view.learner[Activity::kIntake] = intake;
  view.learner[Activity::kUpdate] = 9 - intake;
  view.learner[Activity::kOther] = 1;
  view.actors_times[Activity::kEnvironment] = environment;
  view.actors_times[Activity::kWire] = wire;
  view.actors_times[Activity::kInference] = inference;
  view.actors_times[Activity::kPermits] = permits;
  return view;
}

TEST(FleetTimes, TheLearnersWaitIsSharedOutByWhatActorsDo) {
  // Actors wait half the time, which is as long as the learner works: nobody waits without a reason.
  const ByActivity times = FleetTimes(Fleet(5, 3, 0.5, 1.5, 5));
  EXPECT_NEAR(times[Activity::kUpdate], 0.4, 1e-12);
  EXPECT_NEAR(times[Activity::kOther], 0.1, 1e-12);
  EXPECT_NEAR(times[Activity::kEnvironment], 0.3, 1e-12);
  EXPECT_NEAR(times[Activity::kWire], 0.05, 1e-12);
  EXPECT_NEAR(times[Activity::kInference], 0.15, 1e-12);
  EXPECT_NEAR(times[Activity::kPermits], 0, 1e-12);
  EXPECT_EQ(times[Activity::kIntake], 0);
  EXPECT_NEAR(times.Sum(), 1, 1e-12);
}

TEST(FleetTimes, WaitingForPermitsBeyondTheLearnersWorkCounts) {
  // The learner works 10% of the time, actors wait 70%: 60% are theirs.
  const ByActivity times = FleetTimes(Fleet(9, 2, 0, 1, 7));
  EXPECT_NEAR(times[Activity::kPermits], 0.9 * 0.6 / 0.9, 1e-12);
  EXPECT_NEAR(times.Sum(), 1, 1e-12);
}

TEST(FleetTimes, WithoutPlayTheLearnerWaits) {
  EXPECT_NEAR(FleetTimes(Fleet(9, 0, 0, 0, 10))[Activity::kIntake], 0.9, 1e-12);
  EXPECT_EQ(FleetTimes(FleetView()).Sum(), 0);
}

TEST(FindBottleneck, NamesTheLargestPartAndWhatToAdd) {
  const struct {
    FleetView view;
    std::string part;
    std::string advice;
  } cases[] = {
      {Fleet(1, 1, 0, 1, 8), "learner", "The learner works 90% of the time: give it more or faster CPUs"},
      {Fleet(9, 7, 1, 1, 1), "environment", "Games take 70% of the time: add environment servers."},
      {Fleet(9, 1, 1, 7, 1), "inference", "inference takes 70% of the time: add actors."},
      {Fleet(9, 1, 7, 1, 1), "wire", "Messages take 70% of the time: add actors, whose waits overlap"},
      {Fleet(9, 1, 0, 1, 8), "permits", "Actors wait for lanes 70% of the time"},
  };
  for (const auto& c : cases) {
    const Bottleneck found = FindBottleneck(c.view);
    EXPECT_EQ(found.part, c.part);
    EXPECT_THAT(found.advice, HasSubstr(c.advice));
  }
}

// Making all of play faster helps more than making the learner so, though no part of it is as large.
TEST(FindBottleneck, ALearnerThatWaitsMoreThanItWorksIsNotTheBottleneck) {
  EXPECT_EQ(FindBottleneck(Fleet(5.5, 2, 2, 3, 4.5)).part, "inference");
  EXPECT_EQ(FindBottleneck(Fleet(4.5, 2, 2, 3, 4.5)).part, "learner");
}

TEST(FindBottleneck, WhatIsMissingComesFirst) {
  FleetView view = Fleet(9, 0, 0, 0, 0);
  view.steps_per_second = 0;
  view.env_servers = 0;
  view.lost_env_servers = 2;
  EXPECT_THAT(FindBottleneck(view).advice, HasSubstr("None of 2 environment servers answers"));
  view.lost_env_servers = 0;
  EXPECT_EQ(FindBottleneck(view).part, "environment servers");
  EXPECT_THAT(FindBottleneck(view).advice, HasSubstr("start craftfleet-envserver"));
  view.actors = 0;
  EXPECT_EQ(FindBottleneck(view).part, "actors");
  EXPECT_THAT(FindBottleneck(view).advice, HasSubstr("start craftfleet-actor"));
  view.paused = true;
  EXPECT_EQ(FindBottleneck(view).advice, "Play is paused.");
  view.finished = true;
  EXPECT_EQ(FindBottleneck(view).advice, "The run is complete.");
}

TEST(FindBottleneck, LostServersAreNamedWhereTheyMatter) {
  FleetView view = Fleet(9, 7, 1, 1, 1);
  view.env_servers = 1;
  view.lost_env_servers = 1;
  EXPECT_THAT(FindBottleneck(view).advice, HasSubstr("add environment servers (1 of 2 no longer answers)."));
}

TEST(FindBottleneck, SaysNothingTooEarly) {
  FleetView view = Fleet(0, 1, 1, 1, 1);
  view.learner = ByActivity();
  view.learner[Activity::kUpdate] = 1;
  EXPECT_EQ(FindBottleneck(view).part, "none");
}

TEST(FindBottleneck, EveryAdviceIsOneSentence) {
  for (int mask = 0; mask < 32; ++mask) {
    FleetView view = Fleet(mask % 10, mask & 1, mask & 2, mask & 4, mask & 8);
    view.actors = mask & 16;
    const Bottleneck bottleneck = FindBottleneck(view);
    EXPECT_THAT(kBottleneckParts, testing::Contains(absl::string_view(bottleneck.part)));
    const std::string& advice = bottleneck.advice;
    ASSERT_FALSE(advice.empty());
    EXPECT_EQ(advice.find(". "), std::string::npos) << advice;
    EXPECT_EQ(advice.back(), '.') << advice;
  }
}

}  // namespace
}  // namespace craftfleet
