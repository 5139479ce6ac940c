#include "deploy/cli/plan/plan_text.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "tests/deploy/cli/plan/sample_costs.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;
using testing::Not;

PlanRequest Request(const Machines& machines) {
  return {SampleCosts(), SampleConfig(), FrameFormat::kRaw, machines, ""};
}

TEST(PlanText, SaysWhatAStepCostsWhatToStartAndWhatWouldHelp) {
  const std::string text = PlanText(Request({2, 2}));
  EXPECT_THAT(text, HasSubstr("on one core of a CPU (measured 2026-01-02 03:04 UTC)"));
  EXPECT_THAT(text, HasSubstr("804.0 us  4 x 200.0 to learn from it (4 epochs), 4.0 to receive it\n"));
  EXPECT_THAT(text, HasSubstr("68.0 us  60.0 to choose the action, 8.0 for messages\n"));
  EXPECT_THAT(text, HasSubstr("12.0 us  6.0 for the game, 6.0 for messages\n"));
  EXPECT_THAT(text, HasSubstr("2 cores on one host:\n"));
  EXPECT_THAT(text, testing::ContainsRegex("synchronous, the default +2,075 +91%   learner\n"));
  EXPECT_THAT(text, testing::ContainsRegex("--overlap=1 or --max_staleness=N +2,262 +100%   learner\n"));
  EXPECT_THAT(
      text,
      HasSubstr(
          "Start (synchronous): 1 learner with 2 threads, 1 actor with 2 threads, 1 environment "
          "server\n in one process:\n  craftfleet train --agent=ppo_cnn --lanes=16 --threads=2 --logdir=runs/plan\n"));
  EXPECT_THAT(text, HasSubstr("At best 2,075 steps/s, with 1.8 cores busy; time: "));
  EXPECT_THAT(text, HasSubstr("\nThe learner works 91% of the time: "));
  EXPECT_THAT(text, HasSubstr("2,262 steps/s  --overlap=1\n"));
  EXPECT_THAT(text, Not(HasSubstr("GPU  ")));
}

TEST(PlanText, OnSeveralHostsTheLearnerAndTheOthersHaveCommandsOfTheirOwn) {
  PlanRequest request = Request({/*cores=*/6, /*host_cores=*/2});
  request.machines.gbit = 10;
  request.config.set_lanes(64);
  request.config.set_max_staleness(2);
  request.config_file = "run.txt";
  request.frames = FrameFormat::kLz4;
  request.costs.act_us = 900;
  const std::string text = PlanText(request);
  EXPECT_THAT(text, HasSubstr("6 cores on 3 hosts of 2, 10 Gbit/s:\n"));
  EXPECT_THAT(
      text, HasSubstr(" on host A:\n  craftfleet-learner --config=run.txt --agent=ppo_cnn --lanes=64 "
                      "--max_staleness=2 --threads=2 --logdir=runs/plan --listen=0.0.0.0:50051 --insecure\n on each of "
                      "2 hosts that play:\n  craftfleet-envserver --listen=127.0.0.1:50061\n  craftfleet-actor "
                      "--learner=A:50051 --envservers=127.0.0.1:50061 --threads=2 --frames=lz4\n"));
  EXPECT_THAT(text, HasSubstr("--insecure is for networks that you trust: deploy/SECURING.md\n"));
}

TEST(PlanText, SeveralLearnersHaveARankEach) {
  PlanRequest request = Request({/*cores=*/4, /*host_cores=*/1});
  request.machines.gbit = 100;
  request.machines.max_learners = 9;
  request.config.set_overlap(1);
  const std::string text = PlanText(request);
  EXPECT_THAT(text, HasSubstr("Start (--overlap=1): 2 learners with 1 thread each, 1 actor with 1 thread, "));
  EXPECT_THAT(text, HasSubstr("--insecure --world_size=2 --rank=0\n on 1 further host, with N = 1, 2, ...:\n"));
  EXPECT_THAT(text, HasSubstr(" --world_size=2 --rank=N --master_addr=A\n on a host that plays:\n"));
}

TEST(PlanText, WhatIsNotCountedIsSaid) {
  PlanRequest request = Request({1, 1});
  EXPECT_THAT(PlanText(request), Not(HasSubstr("Not counted")));
  request.config.mutable_distillation()->set_every_iterations(8);
  EXPECT_THAT(PlanText(request), HasSubstr("Not counted: distillation.\n"));
}

TEST(PlanText, ANetworkThatNothingUsesIsMentioned) {
  PlanRequest request = Request({2, 2});
  request.machines.gbit = 1;
  EXPECT_THAT(PlanText(request), HasSubstr("2 cores on one host (nothing travels over the network):\n"));
  request = Request({4, 2});
  request.machines.gbit = 0.001;
  EXPECT_THAT(PlanText(request), HasSubstr("; one of them is as fast as all:\n"));
}

TEST(PlanJson, HasThePlanTheModesTheRemediesAndTheCosts) {
  const PlanRequest request = Request({2, 2});
  const nlohmann::json json = nlohmann::json::parse(PlanJson(request));
  EXPECT_EQ(json["agent"], "ppo_cnn");
  EXPECT_EQ(json["mode"], "synchronous");
  EXPECT_NEAR(json["plan"]["steps_per_second"], 1e6 / 482, 1e-6);
  EXPECT_EQ(json["plan"]["steps_per_second"], json["synchronous"]);
  EXPECT_NEAR(json["overlapped"], 1e6 / 442, 1e-6);
  EXPECT_EQ(json["plan"]["learner_threads"], 2);
  EXPECT_EQ(json["plan"]["env_servers"], 1);
  EXPECT_EQ(json["plan"]["bottleneck"], "learner");
  EXPECT_EQ(json["plan"]["commands"].size(), 2);
  double sum = 0;
  for (const auto& [name, share] : json["plan"]["times"].items()) sum += share.get<double>();
  EXPECT_NEAR(sum, 1, 1e-9);
  EXPECT_EQ(json["remedies"].size(), 2);
  EXPECT_EQ(json["costs"]["act_us"], 60);
}

}  // namespace
}  // namespace craftfleet
