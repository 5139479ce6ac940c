#include "learner/ppo/gae.h"

#include <vector>

#include <gtest/gtest.h>

#include "tests/agent/golden_agent.h"

namespace craftfleet {
namespace {

using Floats = std::vector<float>;

struct Result {
  Floats advantages;
  Floats returns;
};

Result Compute(const LaneSteps& steps, const GaeOptions& options) {
  Result result{Floats(steps.rewards.size()), Floats(steps.rewards.size())};
  ComputeGae(steps, options, absl::MakeSpan(result.advantages), absl::MakeSpan(result.returns));
  return result;
}

TEST(Gae, MatchesTheGoldenBitForBit) {
  const nlohmann::json golden = ReadGolden("gae.json");
  ASSERT_EQ(golden["cases"].size(), 5);
  for (const nlohmann::json& example : golden["cases"]) {
    const auto rewards = example["rewards"].get<Floats>();
    const auto values = example["values"].get<Floats>();
    // A step ends an episode if the next one starts another.
    std::vector<StepEnd> ends;
    for (size_t t = 1; t < rewards.size(); ++t) {
      ends.push_back(example["episode_starts"][t] == 1.0 ? StepEnd::kTerminated : StepEnd::kNone);
    }
    ends.push_back(example["last_done"].get<bool>() ? StepEnd::kTerminated : StepEnd::kNone);
    const Result result = Compute({rewards, values, ends, {}, example["last_value"].get<float>()},
                                  {example["gamma"], example["gae_lambda"], false});
    EXPECT_EQ(result.advantages, example["advantages"].get<Floats>());
    EXPECT_EQ(result.returns, example["returns"].get<Floats>());
  }
}

TEST(Gae, TruncationBootstrapsFromTheLastFrameAndStopsTheSum) {
  const Floats rewards = {1, 2, 3};
  const Floats values = {10, 20, 30};
  const std::vector<StepEnd> ends = {StepEnd::kNone, StepEnd::kTruncated, StepEnd::kNone};
  const Floats truncation_values = {100};
  const LaneSteps steps = {rewards, values, ends, truncation_values, 40};
  const Result result = Compute(steps, {0.5, 0.5, false});
  EXPECT_EQ(result.advantages, (Floats{1 + 10 - 10 + 0.25F * 32, 2 + 50 - 20, 3 + 20 - 30}));
  EXPECT_EQ(result.returns, (Floats{19, 52, 23}));
  const Result terminal = Compute(steps, {0.5, 0.5, true});
  EXPECT_EQ(terminal.advantages, (Floats{1 + 10 - 10 + 0.25F * -18, 2 - 20, 3 + 20 - 30}));
}

TEST(Gae, TruncationValuesGoToTheirEpisodesInOrder) {
  const Floats rewards = {0, 0, 0};
  const Floats values = {0, 0, 0};
  const std::vector<StepEnd> ends = {StepEnd::kTruncated, StepEnd::kTerminated, StepEnd::kTruncated};
  const Floats truncation_values = {2, 4};
  const Result result = Compute({rewards, values, ends, truncation_values, 100}, {0.5, 0.5, false});
  EXPECT_EQ(result.advantages, (Floats{1, 0, 2}));
}

}  // namespace
}  // namespace craftfleet
