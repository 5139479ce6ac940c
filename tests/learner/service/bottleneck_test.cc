#include "learner/service/bottleneck.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/telemetry/metric_table.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;

// A fleet whose learner waits `intake` of 10 s, with the given times of its actors.
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

TEST(FleetTimes, TheLearnersWaitIsDividedByTheActorsActivities) {
  // Actors wait half the time, which is as long as the learner works, so this waiting is not counted.
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
  // The learner works 10% of the time and actors wait 70%, so 60% count as waiting for permits.
  const ByActivity times = FleetTimes(Fleet(9, 2, 0, 1, 7));
  EXPECT_NEAR(times[Activity::kPermits], 0.9 * 0.6 / 0.9, 1e-12);
  EXPECT_NEAR(times.Sum(), 1, 1e-12);
}

TEST(FleetTimes, WithoutPlayTheLearnerWaits) {
  EXPECT_NEAR(FleetTimes(Fleet(9, 0, 0, 0, 10))[Activity::kIntake], 0.9, 1e-12);
  EXPECT_EQ(FleetTimes(FleetView()).Sum(), 0);
}

// The actors that wait for it also wait for permits: the advice was to run fewer of them.
TEST(FindBottleneck, ASlowServerIsNamedWhateverElseTakesLong) {
  for (FleetView view : {Fleet(9, 2, 0, 1, 7), Fleet(1, 1, 0, 1, 8), FleetView(Fleet(5, 3, 0.5, 1.5, 5))}) {
    view.env_servers = 2;
    view.slow_env_servers = {"10.0.0.7:50061 (430 ms a step)"};
    EXPECT_EQ(FindBottleneck(view).part, "environment");
    EXPECT_THAT(FindBottleneck(view).advice, HasSubstr("Environment server 10.0.0.7:50061 (430 ms a step) is slow: "));
    view.slow_env_servers.emplace_back("another");
    EXPECT_THAT(FindBottleneck(view).advice, HasSubstr(" is slow, as is 1 more: "));
    view.slow_env_servers.emplace_back("a third");
    EXPECT_THAT(FindBottleneck(view).advice, HasSubstr(" is slow, as are 2 more: "));
  }
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

// Faster play helps more than a faster learner, even if each part of play is smaller than the learner's.
TEST(FindBottleneck, ALearnerThatWaitsMoreThanItWorksIsNotTheBottleneck) {
  EXPECT_EQ(FindBottleneck(Fleet(5.5, 2, 2, 3, 4.5)).part, "inference");
  EXPECT_EQ(FindBottleneck(Fleet(4.5, 2, 2, 3, 4.5)).part, "learner");
}

// With overlap the learner may work most of the time and still wait for actors that never wait.
TEST(FindBottleneck, WherePlayGoesOnDuringUpdatesTheBusierSideIsTheBottleneck) {
  FleetView view = Fleet(4, 1, 0, 8.5, 0.5);
  EXPECT_EQ(FindBottleneck(view).part, "learner") << "they take turns";
  view.plays_on = true;
  EXPECT_EQ(FindBottleneck(view).part, "inference") << "the learner works 60% of the time, actors 95%";
  view = Fleet(0.5, 1, 0, 5, 4);
  view.plays_on = true;
  EXPECT_EQ(FindBottleneck(view).part, "learner") << "95% and 60%";
  view = Fleet(8, 0.5, 0, 1, 8.5);
  view.plays_on = true;
  EXPECT_EQ(FindBottleneck(view).part, "permits") << "both wait";
}

TEST(FindBottleneck, AMissingPartComesFirst) {
  FleetView view = Fleet(9, 0, 0, 0, 0);
  view.steps_per_second = 0;
  view.env_servers = 0;
  view.lost_env_servers = 2;
  EXPECT_THAT(FindBottleneck(view).advice, HasSubstr("No environment server answers (2 lost)"));
  view.lost_env_servers = 0;
  EXPECT_EQ(FindBottleneck(view).part, "environment servers");
  EXPECT_THAT(FindBottleneck(view).advice, HasSubstr("start craftfleet-envserver"));
  view.actors = 0;
  EXPECT_EQ(FindBottleneck(view).part, "actors");
  EXPECT_THAT(FindBottleneck(view).advice, HasSubstr("start craftfleet-actor"));
  view.paused = true;
  EXPECT_THAT(FindBottleneck(view).advice, HasSubstr("Play is paused"));
  view.finished = true;
  EXPECT_EQ(FindBottleneck(view).advice, "The run is complete.");
}

TEST(FindBottleneck, AFleetWhoseWorkersAreAllDrainedLacksThem) {
  FleetView view = Fleet(9, 0, 0, 0, 9);
  view.steps_per_second = 0;
  view.drained_actors = 1;
  view.drained_env_servers = 1;
  EXPECT_THAT(FindBottleneck(view).advice, HasSubstr("check the actors' logs")) << "one of two still gets work";
  view.drained_env_servers = 2;
  EXPECT_EQ(FindBottleneck(view).part, "environment servers");
  EXPECT_THAT(FindBottleneck(view).advice, HasSubstr("All environment servers are drained: start another one"));
  view.drained_actors = 2;
  EXPECT_EQ(FindBottleneck(view).part, "actors");
  EXPECT_THAT(FindBottleneck(view).advice, HasSubstr("All actors are drained: start another one"));
  view.evaluating = true;
  EXPECT_EQ(FindBottleneck(view).part, "actors") << "the evaluation waits for one, too";
}

TEST(FindBottleneck, LostServersAreMentionedIfTheyMatter) {
  FleetView view = Fleet(9, 7, 1, 1, 1);
  view.env_servers = 1;
  view.lost_env_servers = 1;
  EXPECT_THAT(FindBottleneck(view).advice, HasSubstr("add environment servers (1 of 2 lost)."));
}

// The rate covers the last 20 seconds, and the actors' waiting for the server looks like waiting for permits.
TEST(FindBottleneck, TheOnlyServerIsReportedMissingAsSoonAsItIsLost) {
  FleetView view = Fleet(9, 1, 0, 1, 8);
  view.env_servers = 0;
  view.lost_env_servers = 1;
  EXPECT_EQ(FindBottleneck(view).part, "environment servers");
  EXPECT_THAT(FindBottleneck(view).advice, HasSubstr("start craftfleet-envserver again; the actors wait for one"));
  view.evaluating = true;
  EXPECT_EQ(FindBottleneck(view).part, "environment servers") << "an evaluation also waits for a server";
}

TEST(FindBottleneck, BeforeTheFirstIterationThereIsNoAdvice) {
  FleetView view = Fleet(9.9, 0, 1, 0, 9);
  view.early = true;
  EXPECT_EQ(FindBottleneck(view).part, "none");
  EXPECT_THAT(FindBottleneck(view).advice, HasSubstr("No iteration has ended yet"));
  view.env_servers = 0;
  view.steps_per_second = 0;
  EXPECT_EQ(FindBottleneck(view).part, "environment servers") << "missing parts are reported anyway";
}

TEST(FindBottleneck, IdleActorsAreNotReportedAsTooMany) {
  FleetView view = Fleet(9, 0, 0, 0, 9);
  view.steps_per_second = 0;
  EXPECT_THAT(FindBottleneck(view).advice,
              HasSubstr("The actors play nothing although 2 environment servers answer: check the actors' logs"));
  // No actor plays during a long update.
  view.learner[Activity::kUpdate] = 20;
  EXPECT_EQ(FindBottleneck(view).part, "learner");
}

TEST(FindBottleneck, GivesNoAdviceTooEarly) {
  FleetView view = Fleet(0, 1, 1, 1, 1);
  view.learner = ByActivity();
  view.learner[Activity::kUpdate] = 1;
  EXPECT_EQ(FindBottleneck(view).part, "none");
}

TEST(FindBottleneck, AllAdviceIsOneSentence) {
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
