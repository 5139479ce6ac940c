// Updates with a rollout that older weights played, for each kind of agent.

#include <algorithm>
#include <cmath>
#include <memory>
#include <string>
#include <vector>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_replace.h>
#include <gmock/gmock.h>
#include <google/protobuf/text_format.h>
#include <gtest/gtest.h>

#include "common/agent/policy.h"
#include "common/agent/weights.h"
#include "common/base/keyed_random.h"
#include "learner/ppo/ppo_updater.h"
#include "tests/agent/golden_agent.h"
#include "tests/fakes/status_matchers.h"
#include "tests/learner/ppo/update_samples.h"

namespace craftfleet {
namespace {

using testing::GoldenFrames;
using testing::GoldenUniforms;

constexpr int kLanes = 2;
constexpr int kSteps = 8;      // of a fragment
constexpr int kFragments = 2;  // of a lane
constexpr int kRows = kLanes * kSteps * kFragments;

// All corrections; with one epoch, in a pass before the update.
constexpr char kAll[] = "ppo { decoupled_objective: true recompute_values: true vtrace_rho_bar: 1 vtrace_c_bar: 1 }";

// Of one minibatch, with the fields in `text` and `more`.
v1::RunConfig ConfigOf(const std::string& text, const std::string& more = "") {
  v1::RunConfig config = SmallConfig(kRows);
  config.mutable_ppo()->set_gamma(0.95);
  config.mutable_ppo()->set_gae_lambda(0.65);
  EXPECT_TRUE(google::protobuf::TextFormat::MergeFromString(text + " " + more, &config)) << text;
  return config;
}

// With weights that are not close to zero; those of different `name`s differ by up to `distance`.
std::unique_ptr<PpoUpdater> MakeUpdater(const v1::RunConfig& config, const std::string& name, double distance,
                                        int threads = 2, const std::string& device = "cpu") {
  auto updater = *PpoUpdater::Create(config, threads, device);
  const AgentSpec& spec = updater->spec();
  std::vector<float> weights = GoldenUniforms("weights", spec.param_count, -0.06, 0.06);
  const std::vector<float> change = GoldenUniforms(name, spec.param_count, -distance, distance);
  for (size_t i = 0; i < weights.size(); ++i) weights[i] += change[i];
  EXPECT_THAT(updater->Load(SaveWeights(spec, weights), updater->SaveOptimizer()), IsOk());
  return updater;
}

// Fragments that the updater's weights play, lane after lane, on random frames; episodes end at random. Also writes the
// log-probability of each action under the weights of `judge`.
std::vector<Fragment> Play(const PpoUpdater& updater, const PpoUpdater& judge, std::vector<double>* judged_log_probs) {
  const AgentSpec& spec = updater.spec();
  const auto policy = *Policy::Create(spec, updater.SaveWeights(), 1);
  const auto judging = *Policy::Create(spec, judge.SaveWeights(), 1);
  std::vector<Fragment> fragments;
  std::vector<float> state;
  for (int i = 0; i < kLanes * kFragments; ++i) {
    Fragment& fragment = fragments.emplace_back();
    fragment.lane = i / kFragments;
    fragment.frames = GoldenFrames(100 + i, kSteps, spec.frame_size);
    if (i % kFragments == 0) state.assign(spec.state_size, 0);
    std::vector<float> judged_state = state;
    for (int step = 0; step < kSteps; ++step) {
      const auto uniform = [&](int k) { return ActionNoise(5, i * kSteps + step, k); };
      if (step == 0 || updater.rollout_options().every_state) {
        fragment.states.insert(fragment.states.end(), state.begin(), state.end());
      }
      const std::string frame = fragment.frames.substr(step * spec.frame_bytes(), spec.frame_bytes());
      const ActResult act = *policy->Act(frame, {0}, {uniform(0)}, absl::MakeSpan(state));
      const ActResult judged = *judging->Act(frame, {0}, {uniform(0)}, absl::MakeSpan(judged_state));
      judged_log_probs->push_back(judged.odds[0].log_probs[static_cast<int>(act.actions[0])]);
      fragment.actions.push_back(static_cast<char>(act.actions[0]));
      fragment.log_probs.push_back(act.log_probs[0]);
      fragment.values.push_back(act.values[0]);
      fragment.rewards.push_back(static_cast<float>(uniform(1)));
      fragment.ends.push_back(uniform(2) < 0.1 ? StepEnd::kTerminated : StepEnd::kNone);
      if (fragment.ends.back() == StepEnd::kNone) continue;
      state.assign(state.size(), 0);
      judged_state.assign(judged_state.size(), 0);
    }
  }
  for (size_t i = 0; i + 1 < fragments.size(); ++i) {
    if (fragments[i].lane == fragments[i + 1].lane) fragments[i].bootstrap_value = fragments[i + 1].values[0];
  }
  return fragments;
}

// An update from the weights `start` with a rollout that `player` played.
struct Updated {
  Updated(const v1::RunConfig& config, const PpoUpdater& player, const std::string& start, double distance,
          int threads = 2)
      : updater(MakeUpdater(config, start, distance, threads)),
        fragments(Play(player, *updater, &judged)),
        rollout(RolloutOf(*updater, fragments)) {
    const absl::StatusOr<UpdateStats> result = updater->Update(0, rollout, NeverStop);
    EXPECT_THAT(result, IsOk());
    if (result.ok()) stats = *result;
  }

  std::unique_ptr<PpoUpdater> updater;
  std::vector<double> judged;  // log-probabilities under `start`
  std::vector<Fragment> fragments;
  Rollout rollout;  // as it came
  UpdateStats stats;
};

class LagUpdate : public ::testing::TestWithParam<const char*> {};

TEST_P(LagUpdate, WithoutLagTheLossIsTheUsualOne) {
  const v1::RunConfig config = ConfigOf(GetParam());
  const auto player = MakeUpdater(config, "a", 0.01);
  const Updated usual(config, *player, "a", 0.01);
  EXPECT_FALSE(usual.stats.importance.has_value());
  for (const char* fields : {kAll, "ppo { decoupled_objective: true }", "ppo { recompute_values: true }",
                             "ppo { vtrace_rho_bar: 1 vtrace_c_bar: 1 }"}) {
    const Updated corrected(ConfigOf(GetParam(), fields), *player, "a", 0.01);
    EXPECT_NEAR(corrected.stats.policy_loss, usual.stats.policy_loss, 1e-6) << fields;
    EXPECT_NEAR(corrected.stats.value_loss, usual.stats.value_loss, 1e-6) << fields;
    EXPECT_NEAR(corrected.stats.approx_kl, usual.stats.approx_kl, 1e-6) << fields;
    EXPECT_NEAR(corrected.stats.explained_variance, usual.stats.explained_variance, 1e-6) << fields;
    EXPECT_NEAR(corrected.stats.gradient_norm, usual.stats.gradient_norm, 1e-5 * usual.stats.gradient_norm) << fields;
    ASSERT_TRUE(corrected.stats.importance.has_value());
    EXPECT_NEAR(corrected.stats.importance->mean, 1, 1e-6) << fields;
    EXPECT_NEAR(corrected.stats.importance->min, 1, 1e-5) << fields;
    EXPECT_NEAR(corrected.stats.importance->max, 1, 1e-5) << fields;
  }
}

// The first of two epochs is as usual and says what the second corrects. With a single minibatch it has the weights
// that the update starts from, as a pass before the update would.
TEST_P(LagUpdate, TheFirstEpochSaysWhatAPassWouldSay) {
  // Dropout's noise would be taken for lag.
  const std::string text = absl::StrReplaceAll(GetParam(), {{"dropout: 0.3", "dropout: 0"}});
  const std::string two_epochs = "ppo { epochs: 2 } ";
  const v1::RunConfig usual_config = ConfigOf(text, two_epochs);
  const auto player = MakeUpdater(usual_config, "a", 0.01);
  const v1::RunConfig config = ConfigOf(text, absl::StrCat(two_epochs, kAll));
  const Updated corrected(config, *player, "b", 0.01);
  const Updated with_pass(ConfigOf(text, absl::StrCat(two_epochs, kAll, " ppo { correction_pass: true }")), *player,
                          "b", 0.01);
  // The published minibatches begin in the middle of fragments, with states that were played.
  if (config.ppo().recurrent_batches() != v1::PpoConfig::PUBLISHED) {
    EXPECT_NEAR(corrected.stats.importance->mean, with_pass.stats.importance->mean, 1e-6);
    EXPECT_NEAR(corrected.stats.importance->min, with_pass.stats.importance->min, 1e-6);
    EXPECT_NEAR(corrected.stats.importance->max, with_pass.stats.importance->max, 1e-6);
  }
  EXPECT_FALSE(corrected.updater->SaveWeights() == with_pass.updater->SaveWeights());
  // The usual first epoch, then another one with what is corrected: another loss than that of two usual ones.
  const Updated usual(usual_config, *player, "b", 0.01);
  EXPECT_FALSE(corrected.updater->SaveWeights() == usual.updater->SaveWeights());
  const Updated first(ConfigOf(text), *player, "b", 0.01);
  const double second_loss = 2 * corrected.stats.policy_loss - first.stats.policy_loss;
  EXPECT_GT(std::abs(second_loss - (2 * usual.stats.policy_loss - first.stats.policy_loss)), 1e-6);

  // Without lag all three agree.
  const Updated same(config, *player, "a", 0.01);
  const Updated usual_same(usual_config, *player, "a", 0.01);
  EXPECT_NEAR(same.stats.policy_loss, usual_same.stats.policy_loss, 1e-6);
  EXPECT_NEAR(same.stats.value_loss, usual_same.stats.value_loss, 1e-6);
  EXPECT_NEAR(same.stats.importance->max, 1, 1e-5);
}

// What the update takes for the probabilities under its first weights are those of an actor with these weights.
TEST_P(LagUpdate, ImportanceWeightsAreThoseOfActing) {
  const v1::RunConfig config = ConfigOf(GetParam(), kAll);
  const auto player = MakeUpdater(config, "a", 0.01);
  const Updated updated(config, *player, "b", 0.01);
  double sum = 0;
  double min = 1e9;
  double max = 0;
  for (size_t row = 0; row < updated.judged.size(); ++row) {
    const double weight = std::exp(updated.judged[row] - updated.rollout.log_probs[row]);
    sum += weight;
    min = std::min(min, weight);
    max = std::max(max, weight);
  }
  EXPECT_GT(max - min, 0.01) << "the weights differ enough to be seen";
  EXPECT_NEAR(updated.stats.importance->mean, sum / kRows, 1e-5);
  EXPECT_NEAR(updated.stats.importance->min, min, 1e-5);
  EXPECT_NEAR(updated.stats.importance->max, max, 1e-5);
}

TEST_P(LagUpdate, ThreadsChangeNoBit) {
  for (const char* epochs : {"ppo { epochs: 1 }", "ppo { epochs: 2 }"}) {
    const v1::RunConfig config = ConfigOf(GetParam(), absl::StrCat(kAll, " ", epochs));
    const auto player = MakeUpdater(config, "a", 0.01);
    const Updated one(config, *player, "b", 0.01, /*threads=*/1);
    const Updated three(config, *player, "b", 0.01, /*threads=*/3);
    EXPECT_TRUE(one.updater->SaveWeights() + one.updater->SaveOptimizer() ==
                three.updater->SaveWeights() + three.updater->SaveOptimizer())
        << epochs;
  }
}

INSTANTIATE_TEST_SUITE_P(
    Agents, LagUpdate,
    ::testing::Values(R"(agent: "ppo_cnn" network { frame_size: 40 })",
                      R"(agent: "ppo_cnn" network { frame_size: 40 } ppo { value_norm_decay: 0.9 })",
                      R"(agent: "ppo_cnn" network { frame_size: 40 } ppo { advantages_over_rollout: true })",
                      R"(agent: "ppo_cnn" network { frame_size: 40 memory: true })",
                      R"(agent: "lstm_cnn" network { frame_size: 40 } ppo { recurrent_batches: SEGMENTS })",
                      R"(agent: "lstm_cnn" network { frame_size: 40 } ppo { recurrent_batches: PUBLISHED })",
                      R"(agent: "oc_sa" network { frame_size: 20 dropout: 0.3 })"));

constexpr char kCnn[] = R"(agent: "ppo_cnn" network { frame_size: 40 })";

// Before the first step the ratio is 1: nothing is clipped, and the loss is the weighted mean of the advantages.
TEST(DecoupledUpdate, FirstMinibatchIsAsByHand) {
  const v1::RunConfig config = ConfigOf(kCnn, "ppo { decoupled_objective: true }");
  const auto player = MakeUpdater(config, "a", 0.02);
  const Updated updated(config, *player, "b", 0.02);
  std::vector<float> advantages = updated.rollout.advantages;
  Normalise(absl::MakeSpan(advantages));
  double loss = 0;
  for (size_t row = 0; row < advantages.size(); ++row) {
    loss -= advantages[row] * std::exp(updated.judged[row] - updated.rollout.log_probs[row]) / kRows;
  }
  EXPECT_NEAR(updated.stats.policy_loss, loss, 1e-5);
  EXPECT_NEAR(updated.stats.approx_kl, 0, 1e-9);
  EXPECT_EQ(updated.stats.clip_fraction, 0);
  EXPECT_GT(Updated(ConfigOf(kCnn), *player, "b", 0.02).stats.approx_kl, 1e-5) << "the usual ratio is to the player";
}

TEST(DecoupledUpdate, StoppedWhileItLooksAtTheRolloutChangesNothing) {
  const v1::RunConfig config = ConfigOf(kCnn, kAll);
  const auto player = MakeUpdater(config, "a", 0.01);
  const Updated updated(config, *player, "b", 0.01);
  const std::string before = updated.updater->SaveWeights() + updated.updater->SaveOptimizer();
  int asked = 0;
  EXPECT_THAT(updated.updater->Update(1, updated.rollout, [&] { return ++asked > 0; }),
              StatusIs(absl::StatusCode::kCancelled, ::testing::HasSubstr("stopped")));
  EXPECT_EQ(asked, 1);
  EXPECT_TRUE(updated.updater->SaveWeights() + updated.updater->SaveOptimizer() == before);
}

}  // namespace
}  // namespace craftfleet
