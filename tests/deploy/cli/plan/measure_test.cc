#include "deploy/cli/plan/measure.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "learner/runnable_config.h"
#include "tests/fakes/status_matchers.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;

v1::RunConfig SmallConfig(const std::string& agent) {
  v1::RunConfig config;
  config.set_agent(agent);
  config.set_lanes(4);
  config.set_tile(2);
  config.set_fragment_steps(16);
  config.mutable_env()->set_length(20);  // so that episodes end, and are truncated, in each second fragment
  config.mutable_ppo()->set_rollout_steps(64);
  config.mutable_ppo()->set_minibatch_size(32);
  return *CompleteConfig(config);
}

TEST(MeasureCosts, FindsEveryCost) {
  for (const char* agent : {"ppo_cnn", "lstm_cnn"}) {
    const v1::RunConfig config = SmallConfig(agent);
    const absl::StatusOr<Costs> costs = MeasureCosts(config, "cpu", absl::Milliseconds(300));
    ASSERT_THAT(costs, IsOk());
    EXPECT_THAT(ParseCosts(FormatCosts(*costs), "costs"), IsOk()) << "all are above 0";
    EXPECT_EQ(costs->config, CostlyFields(config));
    EXPECT_TRUE(costs->two_thread_us.has_value());
    EXPECT_LE(*costs->two_thread_us, costs->update_us);
    EXPECT_FALSE(costs->gpu_update_us.has_value());
  }
}

TEST(MeasureCosts, OnAnotherDeviceUpdatesAreMeasuredToo) {
  const absl::StatusOr<Costs> costs = MeasureCosts(SmallConfig("ppo_cnn"), "cpu:0", absl::Milliseconds(100));
  ASSERT_THAT(costs, IsOk());
  EXPECT_TRUE(costs->gpu_update_us.has_value());
}

TEST(MeasureGames, RawFramesTravelWholeOthersSmaller) {
  const v1::RunConfig config = SmallConfig("ppo_cnn");
  const absl::StatusOr<FrameCosts> raw = MeasureGames(config, FrameFormat::kRaw, absl::Milliseconds(100));
  ASSERT_THAT(raw, IsOk());
  EXPECT_GT(raw->bytes, 64 * 64 * 3);
  EXPECT_LT(raw->bytes, 64 * 64 * 3 + 2000) << "a snapshot of some 12,000 bytes for 16 steps";
  EXPECT_LE(raw->game_us, raw->server_us);
  const absl::StatusOr<FrameCosts> scene = MeasureGames(config, FrameFormat::kScene, absl::Milliseconds(100));
  ASSERT_THAT(scene, IsOk());
  const absl::StatusOr<FrameCosts> lz4 = MeasureGames(config, FrameFormat::kLz4, absl::Milliseconds(100));
  ASSERT_THAT(lz4, IsOk());
  EXPECT_LT(lz4->bytes, raw->bytes / 2);
  EXPECT_LT(scene->bytes, lz4->bytes);
  EXPECT_LT(scene->bytes, 2000);
}

TEST(MeasureGames, AnUnknownGameIsRefused) {
  v1::RunConfig config = SmallConfig("ppo_cnn");
  config.mutable_env()->set_name("pong");
  EXPECT_THAT(MeasureGames(config, FrameFormat::kRaw, absl::Milliseconds(1)),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("unknown game \"pong\"")));
}

}  // namespace
}  // namespace craftfleet
