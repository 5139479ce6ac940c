#include "deploy/cli/plan/costs.h"

#include <cstdlib>
#include <filesystem>

#include <absl/strings/str_replace.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/io/files.h"
#include "tests/deploy/cli/plan/sample_costs.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/temp_folder.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;
using testing::Not;

TEST(Costs, AreReadAsTheyWereWritten) {
  Costs costs = SampleCosts();
  costs.gpu_update_us = 5.5;
  const std::string text = FormatCosts(costs);
  const absl::StatusOr<Costs> read = ParseCosts(text, "costs.json");
  ASSERT_TRUE(read.ok()) << read.status();
  EXPECT_EQ(FormatCosts(*read), text);
  EXPECT_EQ((*read)[FrameFormat::kScene].learner_us, 10);
  EXPECT_EQ(read->gpu_update_us, 5.5);
  costs.two_thread_us.reset();
  costs.gpu_update_us.reset();
  EXPECT_FALSE(ParseCosts(FormatCosts(costs), "costs.json")->two_thread_us.has_value());
}

TEST(Costs, ANumberThatNoCostCanBeIsRefusedByName) {
  const std::string text = FormatCosts(SampleCosts());
  const auto error = [&](const std::string& from, const std::string& to) {
    const std::string changed = absl::StrReplaceAll(text, {{from, to}});
    EXPECT_NE(changed, text);
    return std::string(ParseCosts(changed, "costs.json").status().message());
  };
  EXPECT_EQ(error("\"act_us\": 60.0", "\"act_us\": 0"), "costs.json: act_us, want a number above 0, at most 1e+12");
  EXPECT_THAT(error("\"act_us\": 60.0", "\"act_us\": -1"), HasSubstr("act_us, want a number"));
  EXPECT_THAT(error("\"act_us\": 60.0", "\"act_us\": 1e13"), HasSubstr("act_us, want a number"));
  EXPECT_THAT(error("\"act_us\": 60.0", "\"act_us\": \"60\""), HasSubstr("act_us, want a number"));
  EXPECT_THAT(error("\"act_us\"", "\"act\""), HasSubstr("act_us, want a number"));
  EXPECT_THAT(error("\"two_thread_us\": 110.0", "\"two_thread_us\": null"), HasSubstr("two_thread_us, want a number"));
  EXPECT_THAT(error("\"bytes\": 100.0", "\"bytes\": false"), HasSubstr("scene.bytes, want a number"));
  EXPECT_THAT(error("\"cpu\": \"a CPU\"", "\"cpu\": 3"), HasSubstr("cpu, want a text"));
  EXPECT_THAT(error("\"scene\"", "\"scenes\""), HasSubstr("scene, want an object"));
  EXPECT_THAT(std::string(ParseCosts("[1]", "x").status().message()), HasSubstr("x: not the JSON that"));
  EXPECT_THAT(std::string(ParseCosts("{", "x").status().message()), HasSubstr("x: not the JSON that"));
}

TEST(Costs, AreKeptInAFolderOrInTheWorkingFolder) {
  const TempFolder folder;
  const std::string path = folder / "a/b/costs.json";
  ASSERT_THAT(KeepCosts(SampleCosts(), path), IsOk());
  EXPECT_EQ(*ReadFile(path), FormatCosts(SampleCosts()));
  const std::filesystem::path before = std::filesystem::current_path();
  std::filesystem::current_path(folder.path());
  EXPECT_THAT(KeepCosts(SampleCosts(), "costs.json"), IsOk());
  std::filesystem::current_path(before);
  EXPECT_EQ(*ReadFile(folder / "costs.json"), FormatCosts(SampleCosts()));
}

TEST(CostlyFields, HasWhatCostsDependOnAndNothingElse) {
  v1::RunConfig config = SampleConfig();
  const std::string fields = CostlyFields(config);
  EXPECT_THAT(fields, HasSubstr("agent: \"ppo_cnn\""));
  EXPECT_THAT(fields, Not(HasSubstr("\n")));
  config.set_seed(7);
  config.set_steps(99);
  config.set_lanes(64);
  config.set_fragment_steps(64);
  config.set_overlap(1);
  config.mutable_ppo()->set_epochs(1);
  config.mutable_ppo()->set_clip(0.3);
  config.mutable_checkpoint()->set_keep(9);
  EXPECT_EQ(CostlyFields(config), fields);
  v1::RunConfig other = config;
  other.mutable_ppo()->set_minibatch_size(256);
  EXPECT_NE(CostlyFields(other), fields);
  other = config;
  other.mutable_network()->set_frame_size(72);
  EXPECT_NE(CostlyFields(other), fields);
  other = config;
  other.set_gradient_shards(4);
  EXPECT_NE(CostlyFields(other), fields);
}

TEST(DefaultCostsPath, IsInTheUsersCache) {
  setenv("XDG_CACHE_HOME", "/cache", 1);
  setenv("HOME", "/home/someone", 1);
  EXPECT_EQ(*DefaultCostsPath("oc_sa"), "/cache/craftfleet/costs/oc_sa.json");
  setenv("XDG_CACHE_HOME", "", 1);
  EXPECT_EQ(*DefaultCostsPath("oc_sa"), "/home/someone/.cache/craftfleet/costs/oc_sa.json");
  unsetenv("HOME");
  EXPECT_THAT(std::string(DefaultCostsPath("oc_sa").status().message()), HasSubstr("say with --costs"));
}

}  // namespace
}  // namespace craftfleet
