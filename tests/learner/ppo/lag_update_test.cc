// Updates with a rollout that older weights played, for each kind of agent.

#include <algorithm>
#include <cmath>
#include <memory>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <google/protobuf/text_format.h>
#include <gtest/gtest.h>

#include "common/agent/policy.h"
#include "common/agent/weights.h"
#include "learner/ppo/ppo_updater.h"
#include "tests/agent/golden_agent.h"
#include "tests/fakes/status_matchers.h"
#include "tests/learner/ppo/update_samples.h"

namespace craftfleet {
namespace lag_update_test {

constexpr int kLanes = 2;
constexpr int kSteps = 8;      // of a fragment
constexpr int kFragments = 2;  // of a lane
constexpr int kRows = kLanes * kSteps * kFragments;

// Two epochs: the first says what the second corrects.
constexpr char kTwoEpochs[] = "ppo { epochs: 2 } ";
constexpr char kCorrected[] = "overlap: 1 ppo { epochs: 2 } ";

// Of one minibatch, with the fields in `text` and `more`.
v1::RunConfig ConfigOf(const std::string& text, const std::string& more = "") {
  v1::RunConfig config = SmallConfig(kRows);
  config.mutable_ppo()->set_gamma(0.95);
  config.mutable_ppo()->set_gae_lambda(0.65);
  EXPECT_TRUE(google::protobuf::TextFormat::MergeFromString(text + " " + more, &config)) << text;
  return config;
}

// With weights that are not close to zero; those of different `name`s differ by up to `distance`.
std::unique_ptr<PpoUpdater> MakeUpdater(const v1::RunConfig& config, const std::string& name, double distance) {
  auto updater = *PpoUpdater::Create(config, 2, "cpu", PpoUpdater::Start::kZeros);
  const AgentSpec& spec = updater->spec();
  std::vector<float> weights = GoldenUniforms("weights", spec.param_count, -0.06, 0.06);
  const std::vector<float> change = GoldenUniforms(name, spec.param_count, -distance, distance);
  for (size_t i = 0; i < weights.size(); ++i) weights[i] += change[i];
  EXPECT_THAT(updater->Load(SaveWeights(spec, weights), *updater->SaveOptimizer()), IsOk());
  return updater;
}

// The log-probability of each action of the fragments under the weights of `judge`.
std::vector<double> LogProbsUnder(const PpoUpdater& judge, const std::vector<Fragment>& fragments) {
  const AgentSpec& spec = judge.spec();
  const auto policy = *Policy::Create(spec, *judge.SaveWeights(), 1);
  std::vector<double> log_probs;
  for (const Fragment& fragment : fragments) {
    std::vector<float> state(fragment.states.begin(), fragment.states.begin() + spec.state_size);
    for (int step = 0; step < kSteps; ++step) {
      const std::string frame = fragment.frames.substr(step * spec.frame_bytes(), spec.frame_bytes());
      const ActResult act = *policy->Act(frame, {0}, {0.5}, absl::MakeSpan(state));
      log_probs.push_back(act.odds[0].log_probs[static_cast<int>(fragment.actions[step])]);
      if (fragment.ends[step] != StepEnd::kNone) state.assign(state.size(), 0);
    }
  }
  return log_probs;
}

// An update from the weights `start` with a rollout that `player` played.
struct Updated {
  Updated(const v1::RunConfig& config, const PpoUpdater& player, const std::string& start, double distance)
      : updater(MakeUpdater(config, start, distance)),
        fragments(PlayFragments(player, kLanes, kFragments, kSteps)),
        rollout(RolloutOf(*updater, fragments)) {
    const absl::StatusOr<UpdateStats> result = updater->Update(0, rollout, NeverStop);
    EXPECT_THAT(result, IsOk());
    if (result.ok()) stats = *result;
  }

  std::unique_ptr<PpoUpdater> updater;
  std::vector<Fragment> fragments;
  Rollout rollout;  // as it came
  UpdateStats stats;
};

class LagUpdate : public testing::TestWithParam<const char*> {};
// Of minibatches that begin where fragments do; published ones begin in their middle, with states that were played.
class LagUpdateFromTheStart : public LagUpdate {};

TEST_P(LagUpdate, WithoutLagTheLossIsTheUsualOne) {
  const v1::RunConfig config = ConfigOf(GetParam(), kTwoEpochs);
  const auto player = MakeUpdater(config, "a", 0.01);
  const Updated usual(config, *player, "a", 0.01);
  EXPECT_FALSE(usual.stats.importance.has_value());
  const Updated corrected(ConfigOf(GetParam(), kCorrected), *player, "a", 0.01);
  EXPECT_NEAR(corrected.stats.policy_loss, usual.stats.policy_loss, 1e-6);
  EXPECT_NEAR(corrected.stats.value_loss, usual.stats.value_loss, 1e-6);
  EXPECT_NEAR(corrected.stats.approx_kl, usual.stats.approx_kl, 1e-6);
  EXPECT_NEAR(corrected.stats.explained_variance, usual.stats.explained_variance, 1e-6);
  EXPECT_NEAR(corrected.stats.gradient_norm, usual.stats.gradient_norm, 1e-5 * usual.stats.gradient_norm);
  ASSERT_TRUE(corrected.stats.importance.has_value());
  EXPECT_NEAR(corrected.stats.importance->mean, 1, 1e-6);
  EXPECT_NEAR(corrected.stats.importance->min, 1, 1e-5);
  EXPECT_NEAR(corrected.stats.importance->max, 1, 1e-5);
}

// The usual first epoch, then another one with what is corrected.
TEST_P(LagUpdate, TheSecondEpochIsCorrected) {
  const v1::RunConfig usual_config = ConfigOf(GetParam(), kTwoEpochs);
  const auto player = MakeUpdater(usual_config, "a", 0.01);
  const Updated corrected(ConfigOf(GetParam(), kCorrected), *player, "b", 0.01);
  const Updated usual(usual_config, *player, "b", 0.01);
  EXPECT_FALSE(*corrected.updater->SaveWeights() == *usual.updater->SaveWeights());
}

// With a single minibatch the first epoch has the weights that the update starts from. What it takes for the
// probabilities under these weights are those of an actor with them.
TEST_P(LagUpdateFromTheStart, ImportanceWeightsAreThoseOfActing) {
  const v1::RunConfig config = ConfigOf(GetParam(), kCorrected);
  const auto player = MakeUpdater(config, "a", 0.01);
  const Updated updated(config, *player, "b", 0.01);
  const std::vector<double> judged = LogProbsUnder(*MakeUpdater(config, "b", 0.01), updated.fragments);
  double sum = 0;
  double min = 1e9;
  double max = 0;
  for (size_t row = 0; row < judged.size(); ++row) {
    const double weight = std::exp(judged[row] - updated.rollout.log_probs[row]);
    sum += weight;
    min = std::min(min, weight);
    max = std::max(max, weight);
  }
  EXPECT_GT(max - min, 0.01) << "the weights differ enough to be seen";
  EXPECT_NEAR(updated.stats.importance->mean, sum / kRows, 1e-5);
  EXPECT_NEAR(updated.stats.importance->min, min, 1e-5);
  EXPECT_NEAR(updated.stats.importance->max, max, 1e-5);
}

constexpr const char* kAgents[] = {
    R"(agent: "ppo_cnn" network { frame_size: 40 })",
    R"(agent: "ppo_cnn" network { frame_size: 40 } ppo { value_norm_decay: 0.9 })",
    R"(agent: "ppo_cnn" network { frame_size: 40 } ppo { advantages_over_rollout: true })",
    R"(agent: "ppo_cnn" network { frame_size: 40 memory: true })",
    R"(agent: "lstm_cnn" network { frame_size: 40 } ppo { recurrent_batches: SEGMENTS })",
    R"(agent: "oc_sa" network { frame_size: 20 dropout: 0 })"};

INSTANTIATE_TEST_SUITE_P(Agents, LagUpdateFromTheStart, testing::ValuesIn(kAgents));
INSTANTIATE_TEST_SUITE_P(Agents, LagUpdate, testing::ValuesIn(kAgents));
INSTANTIATE_TEST_SUITE_P(
    Published, LagUpdate,
    testing::Values(R"(agent: "lstm_cnn" network { frame_size: 40 } ppo { recurrent_batches: PUBLISHED })"));

constexpr char kCnn[] = R"(agent: "ppo_cnn" network { frame_size: 40 })";

// In the second epoch the ratio is to the first one's outputs, not to the player's.
TEST(DecoupledUpdate, TheRatioIsToTheStart) {
  const auto player = MakeUpdater(ConfigOf(kCnn), "a", 0.02);
  const Updated corrected(ConfigOf(kCnn, kCorrected), *player, "b", 0.02);
  const Updated usual(ConfigOf(kCnn, kTwoEpochs), *player, "b", 0.02);
  EXPECT_LT(corrected.stats.approx_kl, usual.stats.approx_kl / 2);
}

// Dropout's noise would be taken for lag.
TEST(DecoupledUpdate, DropoutIsNotCorrected) {
  const std::string text = R"(agent: "oc_sa" network { frame_size: 20 dropout: 0.3 })";
  const auto player = MakeUpdater(ConfigOf(text), "a", 0.01);
  const Updated lagging(ConfigOf(text, kCorrected), *player, "b", 0.01);
  EXPECT_FALSE(lagging.stats.importance.has_value());
  const Updated usual(ConfigOf(text, kTwoEpochs), *player, "b", 0.01);
  EXPECT_TRUE(*lagging.updater->SaveWeights() == *usual.updater->SaveWeights());
}

TEST(DecoupledUpdate, StoppedInTheFirstEpochChangesNothing) {
  const v1::RunConfig config = ConfigOf(kCnn, kCorrected);
  const auto player = MakeUpdater(config, "a", 0.01);
  const Updated updated(config, *player, "b", 0.01);
  const std::string before = *updated.updater->SaveWeights() + *updated.updater->SaveOptimizer();
  int asked = 0;
  EXPECT_THAT(updated.updater->Update(1, updated.rollout, [&] { return ++asked > 0; }),
              StatusIs(absl::StatusCode::kCancelled, testing::HasSubstr("stopped")));
  EXPECT_EQ(asked, 1);
  EXPECT_TRUE(*updated.updater->SaveWeights() + *updated.updater->SaveOptimizer() == before);
}

}  // namespace lag_update_test
}  // namespace craftfleet
