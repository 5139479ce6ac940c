#include "learner/ranks/rank_flags.h"

#include <cstdlib>
#include <string>

#include <absl/flags/commandlineflag.h>
#include <absl/flags/reflection.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace craftfleet {
namespace {

using testing::HasSubstr;

class RankFlagsTest : public testing::Test {
 protected:
  RankFlagsTest() { Clear(); }
  ~RankFlagsTest() override { Clear(); }

  static void Set(const char* variable, const char* value) { setenv(variable, value, 1); }
  static void Give(const char* flag, const char* value) {
    std::string error;
    ASSERT_TRUE(absl::FindCommandLineFlag(flag)->ParseFrom(value, &error)) << error;
  }

 private:
  static void Clear() {
    for (const char* variable : {"RANK", "WORLD_SIZE", "MASTER_ADDR", "MASTER_PORT", "SLURM_PROCID",
                                 "SLURM_STEP_NUM_TASKS", "SLURM_NTASKS", "JOB_COMPLETION_INDEX"}) {
      unsetenv(variable);
    }
  }

  const absl::FlagSaver flags_;
};

TEST_F(RankFlagsTest, ThereIsOneLearnerByDefault) {
  Set("SLURM_NTASKS", "8");  // of a batch job, whose script starts one learner
  Set("SLURM_PROCID", "0");
  Set("JOB_COMPLETION_INDEX", "3");
  const auto options = RankOptionsFromFlags();
  ASSERT_TRUE(options.ok()) << options.status();
  EXPECT_EQ(options->rank, 0);
  EXPECT_EQ(options->world_size, 1);
}

TEST_F(RankFlagsTest, TorchrunsEnvironmentIsTheDefault) {
  Set("RANK", "1");
  Set("WORLD_SIZE", "3");
  Set("MASTER_ADDR", "node1");
  Set("MASTER_PORT", "1234");
  const auto options = RankOptionsFromFlags();
  ASSERT_TRUE(options.ok()) << options.status();
  EXPECT_EQ(options->rank, 1);
  EXPECT_EQ(options->world_size, 3);
  EXPECT_EQ(options->master_addr, "node1");
  EXPECT_EQ(options->master_port, 1234);
  EXPECT_EQ(options->timeout, absl::Minutes(5));
}

TEST_F(RankFlagsTest, SlurmsAndKubernetesEnvironmentsAreKnown) {
  Set("SLURM_STEP_NUM_TASKS", "4");
  Set("SLURM_PROCID", "2");
  EXPECT_EQ(RankOptionsFromFlags()->rank, 2);
  EXPECT_EQ(RankOptionsFromFlags()->world_size, 4);
  unsetenv("SLURM_PROCID");
  Set("JOB_COMPLETION_INDEX", "3");
  EXPECT_EQ(RankOptionsFromFlags()->rank, 3);
}

TEST_F(RankFlagsTest, FlagsGoBeforeTheEnvironment) {
  Set("RANK", "1");
  Set("WORLD_SIZE", "3");
  Set("MASTER_PORT", "none");
  Give("rank", "0");
  Give("world_size", "2");
  Give("master_addr", "node2");
  Give("master_port", "999");
  Give("rank_timeout", "30s");
  const auto options = RankOptionsFromFlags();
  ASSERT_TRUE(options.ok()) << options.status();
  EXPECT_EQ(options->rank, 0);
  EXPECT_EQ(options->world_size, 2);
  EXPECT_EQ(options->master_addr, "node2");
  EXPECT_EQ(options->master_port, 999);
  EXPECT_EQ(options->timeout, absl::Seconds(30));
}

TEST_F(RankFlagsTest, WhatSaysHowManyRanksThereAreIsKnown) {
  EXPECT_EQ(RankOptionsFromFlags()->given, "--world_size=1");
  Set("SLURM_STEP_NUM_TASKS", "4");
  EXPECT_EQ(RankOptionsFromFlags()->given, "SLURM_STEP_NUM_TASKS=4 of the environment");
  Set("WORLD_SIZE", "3");
  EXPECT_EQ(RankOptionsFromFlags()->given, "WORLD_SIZE=3 of the environment");
  Give("world_size", "2");
  EXPECT_EQ(RankOptionsFromFlags()->given, "--world_size=2");
}

TEST_F(RankFlagsTest, BadVariablesAreNamed) {
  Set("WORLD_SIZE", "two");
  EXPECT_THAT(std::string(RankOptionsFromFlags().status().message()),
              HasSubstr("WORLD_SIZE=two of the environment, want 1..256, or give --world_size"));
  Set("WORLD_SIZE", "2");
  Set("RANK", "2");
  EXPECT_THAT(std::string(RankOptionsFromFlags().status().message()),
              HasSubstr("RANK=2 of the environment, want 0..1"));
}

}  // namespace
}  // namespace craftfleet
