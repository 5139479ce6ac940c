#include "deploy/cli/plan/planner.h"

#include <algorithm>
#include <random>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/deploy/cli/plan/sample_costs.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;

constexpr double kTolerance = 1e-6;

v1::RunConfig Overlapped(v1::RunConfig config) {
  config.set_overlap(1);
  return config;
}

Machines OneHost(int cores) { return {cores, cores}; }

FleetPlan Plan(const Machines& machines, const v1::RunConfig& config = SampleConfig(),
               const Costs& costs = SampleCosts(), FrameFormat format = FrameFormat::kRaw) {
  return PlanFleet(costs, config, format, machines);
}

TEST(UpdateMicros, ThreadsShareOutWholeShards) {
  Costs costs = SampleCosts();
  // 110 = 200 (s + (1 - s) / 2): a tenth is not shared out.
  EXPECT_NEAR(UpdateMicros(costs, 4, 1), 200, kTolerance);
  EXPECT_NEAR(UpdateMicros(costs, 4, 2), 110, kTolerance);
  EXPECT_NEAR(UpdateMicros(costs, 4, 3), 110, kTolerance) << "one thread has two of four shards";
  EXPECT_NEAR(UpdateMicros(costs, 4, 4), 200 * (0.1 + 0.9 / 4), kTolerance);
  EXPECT_NEAR(UpdateMicros(costs, 4, 99), 200 * (0.1 + 0.9 / 4), kTolerance);
  EXPECT_NEAR(UpdateMicros(costs, 1, 4), 200, kTolerance);
  costs.two_thread_us.reset();
  EXPECT_NEAR(UpdateMicros(costs, 4, 4), 50, kTolerance);
}

// T = 4 * 200 + 80 + 4: everything in turn on one core.
TEST(PlanFleet, OnOneCoreAllWorkAddsUp) {
  const FleetPlan plan = Plan(OneHost(1));
  EXPECT_NEAR(plan.steps_per_second, 1e6 / 884, kTolerance);
  EXPECT_NEAR(plan.cores_used, 1, kTolerance);
  EXPECT_EQ(plan.learner_threads, 1);
  EXPECT_EQ(plan.actor_threads, 1);
  EXPECT_NEAR(Plan(OneHost(1), Overlapped(SampleConfig())).steps_per_second, 1e6 / 884, kTolerance)
      << "overlap has no time to win where no core is idle";
}

// T = 4 * 110 + (80 + 4) / 2.
TEST(PlanFleet, SynchronousPlayAndUpdatesTakeTurns) {
  const FleetPlan plan = Plan(OneHost(2));
  EXPECT_NEAR(plan.steps_per_second, 1e6 / 482, kTolerance);
  EXPECT_NEAR(plan.cores_used, 884.0 / 482, kTolerance);
  EXPECT_EQ(plan.learner_threads, 2);
  EXPECT_EQ(plan.actor_threads, 2);
  EXPECT_EQ(plan.actors, 1);
  EXPECT_EQ(plan.env_servers, 1);
  EXPECT_EQ(plan.limit.part, "learner");
  EXPECT_THAT(plan.limit.advice, HasSubstr("The learner works 91% of the time"));
}

// T = 884 / 2 where the cores are shared, and 4 * 200 with a core for the learner alone.
TEST(PlanFleet, OverlappedTheLongerOfBothCounts) {
  const FleetPlan one = Plan(OneHost(2), Overlapped(SampleConfig()));
  EXPECT_NEAR(one.steps_per_second, 1e6 / 442, kTolerance);
  EXPECT_NEAR(one.cores_used, 2, kTolerance);
  EXPECT_EQ(one.limit.part, "learner");
  const FleetPlan two = Plan({/*cores=*/2, /*host_cores=*/1}, Overlapped(SampleConfig()));
  EXPECT_NEAR(two.steps_per_second, 1e6 / 800, kTolerance);
  EXPECT_EQ(two.hosts, 2);
  EXPECT_EQ(two.actor_threads, 1);
  v1::RunConfig asynchronous = SampleConfig();
  asynchronous.set_max_staleness(2);
  EXPECT_NEAR(Plan(OneHost(2), asynchronous).steps_per_second, one.steps_per_second, kTolerance);
}

// With an agent that acts slowly: 5020 us a step in an actor and a server.
TEST(PlanFleet, ThePolicyIsTheLimitOfSlowAgents) {
  Costs costs = SampleCosts();
  costs.act_us = 5000;
  const FleetPlan plan = Plan(OneHost(2), SampleConfig(), costs);
  EXPECT_NEAR(plan.steps_per_second, 1e6 / (440 + 2512), kTolerance);
  EXPECT_EQ(plan.limit.part, "inference");
  EXPECT_THAT(plan.limit.advice, HasSubstr("inference takes 85% of the time: add actors"));
}

TEST(PlanFleet, NoMoreThreadsPlayThanThereAreTilesOfLanes) {
  Costs costs = SampleCosts();
  costs.act_us = 5000;
  const FleetPlan plan = Plan(OneHost(16), SampleConfig(), costs);
  EXPECT_EQ(plan.actor_threads, 2);
  EXPECT_NEAR(plan.play_us, 2510, kTolerance);
  EXPECT_EQ(plan.limit.part, "inference");
  EXPECT_THAT(plan.limit.advice, HasSubstr("2 threads play all 16 lanes: train with more lanes"));
  v1::RunConfig config = SampleConfig();
  config.set_lanes(128);
  EXPECT_NEAR(Plan(OneHost(16), config, costs).play_us, 5024.0 / 16, kTolerance) << "with the learner's intake";
}

// 0.1 Gbit/s take 8 / 94.1 us a byte: 12,500 bytes of a step, and 2.5e6 / 4096 of weights for each actor.
TEST(PlanFleet, AFullLinkLimitsTheNumberOfActors) {
  Costs costs = SampleCosts();
  costs.act_us = 5000;
  v1::RunConfig config = Overlapped(SampleConfig());
  config.set_lanes(64);
  config.mutable_ppo()->set_epochs(1);
  Machines machines{/*cores=*/8, /*host_cores=*/1};
  machines.gbit = 0.1;
  const FleetPlan plan = Plan(machines, config, costs);
  EXPECT_EQ(plan.hosts, 8);
  EXPECT_EQ(plan.actors, 4) << "a fifth would take more of the link than it would play";
  EXPECT_NEAR(plan.steps_per_second, 1e6 / ((12500 + 4 * 2.5e6 / 4096) * 8 / (100 * 1448.0 / 1538)), kTolerance);
  EXPECT_EQ(plan.limit.part, "wire");
  EXPECT_THAT(plan.limit.advice, HasSubstr("link is full: take a faster one, or send scene records"));
  const FleetPlan scene = Plan(machines, config, costs, FrameFormat::kScene);
  EXPECT_EQ(scene.actors, 7);
  EXPECT_GT(scene.steps_per_second, 1.5 * plan.steps_per_second);
}

TEST(PlanFleet, OneHostIsEnoughWhereTheNetworkCostsMoreThanItsCoresBring) {
  Machines machines{/*cores=*/4, /*host_cores=*/2};
  machines.gbit = 0.01;
  const FleetPlan plan = Plan(machines);
  EXPECT_EQ(plan.hosts, 1);
  EXPECT_NEAR(plan.steps_per_second, Plan(OneHost(2)).steps_per_second, kTolerance);
}

// Frames of 12,500 bytes go over the link once, and a gradient of 2.5e6 twice for each minibatch of 128 samples.
TEST(PlanFleet, SeveralLearnersShareTheShardsAndSendGradients) {
  v1::RunConfig config = Overlapped(SampleConfig());
  config.set_gradient_shards(4);
  Machines machines{/*cores=*/8, /*host_cores=*/1};
  machines.gbit = 10;
  EXPECT_EQ(Plan(machines, config).learners, 1) << "unless more are allowed";
  machines.max_learners = 8;
  const FleetPlan plan = Plan(machines, config);
  EXPECT_EQ(plan.learners, 4) << "as many as there are shards";
  const double sent_us = (12500 + 4 * 2 * 2.5e6 / 128) * 8 / (1e4 * 1448 / 1538);
  EXPECT_NEAR(plan.steps_per_second, 1e6 / (4 * 200 * (0.1 + 0.9 / 4) + sent_us), kTolerance);
}

TEST(PlanFleet, AGpuUpdatesInstead) {
  Costs costs = SampleCosts();
  costs.gpu_update_us = 5;
  Machines machines = OneHost(16);
  machines.gpus = 1;
  const FleetPlan plan = Plan(machines, SampleConfig(), costs);
  EXPECT_NEAR(plan.steps_per_second, 1e6 / (4 * 5 + 80.0 / 2), kTolerance);
  EXPECT_EQ(plan.limit.part, "inference");
}

// A random run with random costs, from cheap to expensive.
struct Case {
  Costs costs = SampleCosts();
  v1::RunConfig config = SampleConfig();
  FrameFormat format = FrameFormat::kRaw;
};

Case RandomCase(std::mt19937* random) {
  const auto one_of = [random](std::initializer_list<double> values) {
    return *(values.begin() + (*random)() % values.size());
  };
  Case c;
  c.costs.update_us = one_of({1, 30, 200, 30000});
  c.costs.two_thread_us = c.costs.update_us * one_of({0.4, 0.5, 0.55, 0.8, 1.5});
  c.costs.gpu_update_us = one_of({0.5, 5, 500});
  c.costs.act_us = one_of({1, 60, 5000});
  c.costs[FrameFormat::kRaw].server_us = one_of({7, 50, 3000});
  c.costs.weight_bytes = one_of({1e4, 2.5e6, 1e8});
  c.config.set_lanes(static_cast<int>(one_of({1, 8, 16, 64, 256})));
  c.config.set_gradient_shards(static_cast<int>(one_of({1, 2, 4, 16})));
  c.config.mutable_ppo()->set_epochs(static_cast<int>(one_of({1, 4})));
  c.config.set_overlap(static_cast<int>(one_of({0, 1})));
  c.format = kFrameFormats[(*random)() % kFrameFormats.size()];
  return c;
}

TEST(PlanFleet, MoreOfAnythingIsNeverSlowerAndNoCoreIsUsedTwice) {
  std::mt19937 random(1);
  for (int i = 0; i < 300; ++i) {
    const Case c = RandomCase(&random);
    Machines machines;
    machines.host_cores = 1 + static_cast<int>(random() % 6);
    machines.gbit = random() % 2 == 0 ? 0 : 0.1 * static_cast<double>(1 + random() % 100);
    machines.gpus = random() % 4 == 0 ? 1 : 0;
    machines.max_learners = 1 + static_cast<int>(random() % 3);
    double rate = 0;
    for (machines.cores = 1; machines.cores <= 20; ++machines.cores) {
      const FleetPlan plan = PlanFleet(c.costs, c.config, c.format, machines);
      EXPECT_GE(plan.steps_per_second, rate * (1 - 1e-9)) << i << ": " << machines.cores << " cores";
      EXPECT_LE(plan.cores_used, machines.cores * (1 + 1e-9)) << i << ": " << machines.cores << " cores";
      EXPECT_LE(plan.learners * plan.learner_threads, machines.cores);
      EXPECT_LE(plan.actor_threads, machines.cores);
      EXPECT_LE(plan.actors, plan.actor_threads);
      rate = plan.steps_per_second;
    }
    machines.cores = 20;
    Machines better = machines;
    better.gbit *= 2;
    EXPECT_GE(PlanFleet(c.costs, c.config, c.format, better).steps_per_second, rate * (1 - 1e-9)) << i;
    better = machines;
    ++better.max_learners;
    EXPECT_GE(PlanFleet(c.costs, c.config, c.format, better).steps_per_second, rate * (1 - 1e-9)) << i;
  }
}

// Of learner and play, and of play's parts.
TEST(PlanFleet, TheBottleneckIsBusyMostOfTheTime) {
  std::mt19937 random(2);
  int learners = 0;
  for (int i = 0; i < 1000; ++i) {
    const Case c = RandomCase(&random);
    Machines machines = OneHost(1 + static_cast<int>(random() % 20));
    if (random() % 2 == 0) machines.host_cores = 1 + static_cast<int>(random() % 4);
    const FleetPlan plan = PlanFleet(c.costs, c.config, c.format, machines);
    const double learner = plan.update_us * plan.steps_per_second / 1e6;
    const ByActivity actors = plan.view.actors_times.Normalized();
    const double playing = 1 - actors[Activity::kPermits];
    EXPECT_NEAR(FleetTimes(plan.view).Sum(), 1, 1e-9);
    EXPECT_LE(learner, 1 + 1e-9);
    if (plan.limit.part == "learner") {
      ++learners;
      EXPECT_GE(learner, std::max(0.5, c.config.overlap() > 0 ? playing : 0) * (1 - 1e-9)) << i;
      continue;
    }
    EXPECT_LE(learner, std::max(0.5, playing) * (1 + 1e-9)) << i;
    const double parts[] = {actors[Activity::kEnvironment], actors[Activity::kInference], actors[Activity::kWire]};
    const double most = *std::max_element(std::begin(parts), std::end(parts));
    const double limit = plan.limit.part == "environment" ? parts[0]
                         : plan.limit.part == "inference" ? parts[1]
                                                          : parts[2];
    EXPECT_GE(limit, most * (1 - 1e-9)) << i << ": " << plan.limit.part;
  }
  EXPECT_GT(learners, 100);
  EXPECT_LT(learners, 900);
}

TEST(FindRemedies, AreFasterPlansThemselves) {
  const std::vector<Remedy> remedies = FindRemedies(SampleCosts(), SampleConfig(), FrameFormat::kRaw, OneHost(2));
  ASSERT_EQ(remedies.size(), 2);
  EXPECT_THAT(remedies[0].change, HasSubstr("ppo { epochs: 2 }"));
  EXPECT_NEAR(remedies[0].steps_per_second, 1e6 / (2 * 110 + 42), kTolerance);
  EXPECT_EQ(remedies[1].change, "--overlap=1");
  EXPECT_NEAR(remedies[1].steps_per_second, 1e6 / 442, kTolerance);
}

TEST(FindRemedies, MoreCoresHelpOnlyWithEnoughShardsAndLanes) {
  const auto names = [](const v1::RunConfig& config) {
    std::string names;
    for (const Remedy& remedy : FindRemedies(SampleCosts(), config, FrameFormat::kRaw, OneHost(2)))
      names += remedy.change + "; ";
    return names;
  };
  EXPECT_THAT(names(SampleConfig()), testing::Not(HasSubstr("twice the cores")));
  v1::RunConfig config = SampleConfig();
  config.set_gradient_shards(4);
  EXPECT_THAT(names(config), HasSubstr("twice the cores"));
}

}  // namespace
}  // namespace craftfleet
