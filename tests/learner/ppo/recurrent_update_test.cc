// Updates of recurrent agents: what acting had is what learning has.

#include <algorithm>
#include <cmath>
#include <numeric>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/agent/weights.h"
#include "learner/ppo/ppo_updater.h"
#include "tests/agent/golden_agent.h"
#include "tests/learner/ppo/update_samples.h"

namespace craftfleet {
namespace recurrent_update_test {

constexpr int kLanes = 3;
constexpr int kSteps = 16;     // of a fragment
constexpr int kFragments = 4;  // of a lane

std::vector<Fragment> Play(const PpoUpdater& updater) { return PlayFragments(updater, kLanes, kFragments, kSteps); }

double ValueLoss(const Rollout& rollout) {
  double sum = 0;
  for (size_t i = 0; i < rollout.size(); ++i) sum += std::pow(rollout.returns[i] - rollout.values[i], 2);
  return sum / static_cast<double>(rollout.size());
}

class RecurrentUpdateTest : public testing::TestWithParam<v1::NetworkConfig::Critic> {
 protected:
  // Whose weights are not close to zero, so that states count.
  static std::unique_ptr<PpoUpdater> MakeUpdater(v1::RunConfig config, int threads = 2) {
    config.mutable_network()->set_critic(GetParam());
    auto updater = *PpoUpdater::Create(config, threads, "cpu", PpoUpdater::Start::kZeros);
    const AgentSpec& spec = updater->spec();
    std::vector<float> weights = GoldenUniforms("weights", spec.param_count, -0.06, 0.06);
    EXPECT_TRUE(updater->Load(SaveWeights(spec, weights), *updater->SaveOptimizer()).ok());
    return updater;
  }
};

// Without learning, every minibatch of every epoch must see the values and probabilities that acting saw.
TEST_P(RecurrentUpdateTest, SegmentsGiveWhatActingGave) {
  v1::RunConfig config = SmallConfig(24, "lstm_cnn");
  config.mutable_ppo()->set_epochs(2);
  config.mutable_ppo()->set_learning_rate(0);
  const auto updater = MakeUpdater(config);
  std::vector<Fragment> fragments = Play(*updater);
  const Rollout rollout = RolloutOf(*updater, fragments);
  const UpdateStats stats = *updater->Update(0, rollout, NeverStop);
  EXPECT_NEAR(stats.approx_kl, 0, 1e-9);
  EXPECT_EQ(stats.clip_fraction, 0);
  config.mutable_ppo()->set_minibatch_size(static_cast<int>(rollout.size()));
  const UpdateStats whole = *MakeUpdater(config)->Update(0, rollout, NeverStop);
  EXPECT_NEAR(whole.value_loss, ValueLoss(rollout), 1e-6 * whole.value_loss);

  for (Fragment& fragment : fragments) fragment.states.assign(fragment.states.size(), 0);
  const UpdateStats forgotten = *updater->Update(0, RolloutOf(*updater, fragments), NeverStop);
  EXPECT_GT(forgotten.approx_kl, 1e-6) << "states count";
}

// Segments that stand beside others, longer or shorter, give the gradients that they give alone.
TEST_P(RecurrentUpdateTest, ShardsAddUpToTheMinibatch) {
  v1::RunConfig config = SmallConfig(kLanes * kFragments * kSteps, "lstm_cnn");
  const std::vector<Fragment> fragments = Play(*MakeUpdater(config));
  std::vector<UpdateStats> all;
  for (const int shards : {1, 2, 4, 32}) {
    config.set_gradient_shards(shards);
    const auto updater = MakeUpdater(config);
    all.push_back(*updater->Update(0, RolloutOf(*updater, fragments), NeverStop));
    EXPECT_NEAR(all.back().gradient_norm, all[0].gradient_norm, 1e-5 * all[0].gradient_norm) << shards << " shards";
    EXPECT_NEAR(all.back().policy_loss, all[0].policy_loss, 1e-6);
    EXPECT_NEAR(all.back().value_loss, all[0].value_loss, 1e-6);
  }
}

TEST_P(RecurrentUpdateTest, PublishedMinibatchesCountTheirPadding) {
  v1::RunConfig config = SmallConfig(24, "lstm_cnn");
  config.mutable_ppo()->set_learning_rate(0);
  config.mutable_ppo()->set_recurrent_batches(v1::PpoConfig::PUBLISHED);
  const auto updater = MakeUpdater(config);
  const std::vector<Fragment> fragments = Play(*updater);
  const UpdateStats stats = *updater->Update(0, RolloutOf(*updater, fragments), NeverStop);
  // A row of zeros has an old log-probability of 0, so its ratio is far from 1; the others are as acting saw them.
  EXPECT_GT(stats.clip_fraction, 0.2);
  EXPECT_NEAR(stats.approx_kl, stats.clip_fraction * (std::exp(-2.833) - 1 + 2.833), 0.2);
}

INSTANTIATE_TEST_SUITE_P(RecurrentUpdate, RecurrentUpdateTest,
                         testing::Values(v1::NetworkConfig::LINEAR, v1::NetworkConfig::LSTM),
                         [](const auto& info) { return v1::NetworkConfig::Critic_Name(info.param) + "Critic"; });

// The golden's rollout; `rows` of it in this order.
struct GoldenRollout {
  explicit GoldenRollout(const nlohmann::json& golden, const std::vector<int>& rows)
      : frames(GoldenFrames(golden["frames_seed"], golden["n_steps"], 64)) {
    const int n = golden["n_steps"];
    const std::vector<float> hidden = GoldenUniforms("rb_h", n * 256, -0.5, 0.5);
    const std::vector<float> cell = GoldenUniforms("rb_c", n * 256, -1, 1);
    states.resize(n * 512);
    for (const int row : rows) {
      rollout.frames.push_back(reinterpret_cast<const uint8_t*>(&frames[row * 64 * 64 * 3]));
      rollout.actions.push_back(static_cast<Action>(golden["actions"][row].get<int>()));
      rollout.log_probs.push_back(golden["old_log_prob"][row]);
      rollout.values.push_back(golden["values"][row]);
      rollout.advantages.push_back(golden["advantages"][row]);
      rollout.returns.push_back(golden["returns"][row]);
      const bool begins = golden["episode_starts"][row] == 1.0;
      rollout.starts.push_back(begins ? RowStart::kEpisode : row == 0 ? RowStart::kLane : RowStart::kNone);
      rollout.states.push_back(&states[row * 512]);
      if (begins) continue;
      std::copy_n(&hidden[row * 256], 256, &states[row * 512]);
      std::copy_n(&cell[row * 256], 256, &states[row * 512 + 256]);
    }
  }

  std::string frames;
  std::vector<float> states;
  Rollout rollout;
};

// An iteration whose epoch begins at row `split`.
int64_t IterationWithSplit(const v1::RunConfig& config, const Rollout& rollout, int split) {
  EpochKey key{config.seed(), 0, 0};
  while (PublishedMinibatches(key, rollout.starts, 1)[0].rows[0] != split) ++key.iteration;
  return key.iteration;
}

void ExpectBatch(const UpdateStats& stats, const nlohmann::json& batch, double tolerance) {
  const auto near = [&](double actual, double wanted) {
    EXPECT_NEAR(actual, wanted, tolerance * std::max(1.0, std::abs(wanted)));
  };
  near(stats.policy_loss, batch["policy_loss"]);
  near(stats.value_loss, batch["value_loss"]);
  near(stats.entropy, -batch["entropy_loss"].get<double>());
  near(stats.clip_fraction, batch["clip_fraction"]);
  near(stats.approx_kl, batch["approx_kl"]);
  // The reference sums 134 million squares in float: 0.7% are lost. The parameters' norms are exact.
  const double norm = batch["grad_norm_total"];
  EXPECT_NEAR(stats.gradient_norm, norm, norm * 1e-2);
}

class RecurrentGolden : public testing::TestWithParam<std::string> {};

TEST_P(RecurrentGolden, PublishedMinibatchesMatch) {
  const nlohmann::json golden = ReadGolden(GetParam() + ".json");
  const nlohmann::json& sample = golden["recurrent_minibatches"];
  v1::RunConfig config = SmallConfig(sample["batch_size"], GetParam());
  config.set_gradient_shards(1);
  config.mutable_ppo()->set_recurrent_batches(v1::PpoConfig::PUBLISHED);
  const auto updater = *PpoUpdater::Create(config, 2, "cpu", PpoUpdater::Start::kZeros);
  const AgentSpec& spec = updater->spec();
  ASSERT_TRUE(updater->Load(SaveWeights(spec, GoldenWeights(spec, golden)), *updater->SaveOptimizer()).ok());

  // Each minibatch alone, so that its numbers are not averaged with the other's.
  const int n = sample["n_steps"];
  std::vector<int> rows(n);
  std::iota(rows.begin(), rows.end(), static_cast<int>(sample["split_index"]));
  for (int& row : rows) row %= n;
  const auto middle = rows.begin() + config.ppo().minibatch_size();
  const GoldenRollout first(sample, {rows.begin(), middle});
  absl::StatusOr<UpdateStats> stats =
      updater->Update(IterationWithSplit(config, first.rollout, 0), first.rollout, NeverStop);
  ASSERT_TRUE(stats.ok()) << stats.status();
  const nlohmann::json& batches = sample["batches"];
  ExpectBatch(*stats, batches[0], 2e-5);
  for (const auto& [name, norm] : FirstGradientNorms(*updater, stats->gradient_norm)) {
    const double known = batches[0]["grad_norms"].at(name);
    EXPECT_NEAR(norm, known, known * 1e-3) << name;
  }
  const GoldenRollout second(sample, {middle, rows.end()});
  stats = updater->Update(IterationWithSplit(config, second.rollout, 0), second.rollout, NeverStop);
  ASSERT_TRUE(stats.ok()) << stats.status();
  // After Adam, which divides small gradients by themselves.
  ExpectBatch(*stats, batches[1], 1e-2);
}

INSTANTIATE_TEST_SUITE_P(RecurrentUpdate, RecurrentGolden, testing::Values("lstm_cnn", "lstm_spcnn"),
                         [](const auto& info) { return info.param; });

}  // namespace recurrent_update_test
}  // namespace craftfleet
