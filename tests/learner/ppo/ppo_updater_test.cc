#include "learner/ppo/ppo_updater.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <map>
#include <numeric>
#include <string>
#include <vector>

#include <ATen/ATen.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/agent/nets/wide_linear.h"
#include "common/agent/policy.h"
#include "common/agent/weights.h"
#include "common/base/crc32c.h"
#include "common/base/keyed_random.h"
#include "tests/agent/golden_agent.h"
#include "tests/learner/ppo/update_samples.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;

// A rollout together with the frames it points to.
struct OwnedRollout {
  std::string frames;
  Rollout rollout;
};

OwnedRollout WithFrames(uint32_t seed, int n, int frame_size = 64) {
  OwnedRollout owned{GoldenFrames(seed, n, frame_size), {}};
  for (int i = 0; i < n; ++i) {
    owned.rollout.frames.push_back(reinterpret_cast<const uint8_t*>(&owned.frames[i * frame_size * frame_size * 3]));
  }
  return owned;
}

OwnedRollout RandomRollout(uint32_t seed, int n, int frame_size = 64) {
  OwnedRollout owned = WithFrames(seed, n, frame_size);
  Rollout& rollout = owned.rollout;
  for (int i = 0; i < n; ++i) {
    const auto uniform = [&](int k) { return static_cast<float>(ActionNoise(seed, i, k)); };
    rollout.actions.push_back(static_cast<Action>(uniform(0) * kNumActions));
    rollout.log_probs.push_back(-2.8F + 0.1F * uniform(1));
    rollout.values.push_back(uniform(2));
    rollout.advantages.push_back(uniform(3) - 0.5F);
    rollout.returns.push_back(rollout.values.back() + rollout.advantages.back());
  }
  return owned;
}

// What a run of `iterations` updates leaves behind.
std::string TrainedState(const v1::RunConfig& config, int threads, int iterations) {
  const OwnedRollout owned = RandomRollout(11, 64);
  const auto updater = *PpoUpdater::Create(config, threads);
  for (int i = 0; i < iterations; ++i) {
    EXPECT_TRUE(updater->Update(i, owned.rollout, NeverStop).ok());
  }
  return *updater->SaveWeights() + *updater->SaveOptimizer();
}

// Of the feed-forward agents as published.
class PpoUpdaterGolden : public testing::TestWithParam<const char*> {};

TEST_P(PpoUpdaterGolden, StepsOnOneMinibatchMatch) {
  const GoldenAgent agent(GetParam());
  const nlohmann::json& batch = agent.golden["ppo_minibatch"];
  const int n = batch["n"];
  OwnedRollout owned = WithFrames(batch["frames_seed"], n, agent.spec.frame_size);
  ASSERT_EQ(ByteSum(owned.frames), batch["frames_byte_sum"]);
  for (const int action : batch["actions"]) owned.rollout.actions.push_back(static_cast<Action>(action));
  owned.rollout.log_probs = batch["old_log_prob"].get<std::vector<float>>();
  owned.rollout.advantages = batch["advantages"].get<std::vector<float>>();
  owned.rollout.returns = batch["returns"].get<std::vector<float>>();
  owned.rollout.values = owned.rollout.returns;

  v1::RunConfig config = SmallConfig(n, agent.spec.name);
  if (agent.spec.network.dropout() > 0) config.mutable_network()->set_dropout(0);  // the goldens are without
  const auto updater = *PpoUpdater::Create(config, 2, "cpu", PpoUpdater::Start::kZeros);
  const AgentSpec& spec = updater->spec();
  ASSERT_TRUE(updater->Load(SaveWeights(spec, agent.weights), *updater->SaveOptimizer()).ok());
  // The first step compares outputs; the later ones follow Adam, which divides small gradients by themselves.
  double tolerance = 2e-5;
  const auto near = [&](double actual, double wanted, const std::string& what) {
    EXPECT_NEAR(actual, wanted, tolerance * std::max(1.0, std::abs(wanted))) << what;
  };
  const auto steps = static_cast<int64_t>(batch["steps"].size());
  for (int64_t i = 0; i < steps; ++i) {
    SCOPED_TRACE(i);
    const nlohmann::json& step = batch["steps"][i];
    const absl::StatusOr<UpdateStats> stats = updater->Update(i, owned.rollout, NeverStop);
    ASSERT_TRUE(stats.ok()) << stats.status();
    near(stats->policy_loss, step["policy_loss"], "policy_loss");
    near(stats->value_loss, step["value_loss"], "value_loss");
    const double entropy = -step["entropy_loss"].get<double>();
    EXPECT_NEAR(stats->entropy, entropy, tolerance * (spec.name == "ppo_cnn" ? 1 : entropy));
    near(stats->approx_kl, step["approx_kl"], "approx_kl");
    EXPECT_NEAR(stats->clip_fraction, step["clip_fraction"].get<double>(), i == 0 ? 0 : 0.0626);
    tolerance = 1e-2;
    // The golden of ppo_spcnn sums 134 million squares in single precision, 0.7% short of its own parts.
    const double norm = step["grad_norm_total"];
    EXPECT_NEAR(stats->gradient_norm, norm, norm * (i == 0 && spec.name != "ppo_spcnn" ? 1e-3 : 1e-2));
    if (i > 0) continue;
    const std::map<std::string, double> norms = FirstGradientNorms(*updater, stats->gradient_norm);
    EXPECT_EQ(norms.size(), step["grad_norms"].size());
    for (const auto& [name, value] : norms) {
      const double known = step["grad_norms"].at(name);
      EXPECT_NEAR(value, known, known * 1e-3) << name;
    }
  }
  EXPECT_EQ(updater->optimizer_steps(), steps);

  const nlohmann::json& after = batch["after"];
  std::vector<int> lanes(n);
  std::iota(lanes.begin(), lanes.end(), 0);
  const ActResult acts = *(*Policy::Create(spec, *updater->SaveWeights(), n))->Act(owned.frames, lanes, {}, {});
  for (int row = 0; row < n; ++row) {
    near(acts.values[row], after["values"][row], "value");
    near(acts.odds[row].log_probs[static_cast<int>(owned.rollout.actions[row])], after["log_prob"][row], "log_prob");
  }
  const absl::StatusOr<UpdateStats> stats = updater->Update(steps, owned.rollout, NeverStop);
  ASSERT_TRUE(stats.ok()) << stats.status();
  near(stats->policy_loss + config.ppo().value_coefficient() * stats->value_loss, after["total"], "total");
}

INSTANTIATE_TEST_SUITE_P(FeedForward, PpoUpdaterGolden, testing::Values("ppo_cnn", "ppo_spcnn", "oc_sa", "oc_ca"),
                         [](const auto& info) { return std::string(info.param); });

TEST(PpoUpdater, ThreadsDoNotChangeABit) {
  const v1::RunConfig config = SmallConfig(32);
  const std::string one = TrainedState(config, 1, 2);
  EXPECT_EQ(TrainedState(config, 1, 2) == one, true);
  EXPECT_EQ(TrainedState(config, 2, 2) == one, true);
  EXPECT_EQ(TrainedState(config, 3, 2) == one, true);
}

// An odd number of rows in each shard, and a layer that WideLinear computes.
TEST(PpoUpdater, ThreadsDoNotChangeABitOfAWideLayer) {
  constexpr int kFrameSize = 24;
  const OwnedRollout owned = RandomRollout(11, 66, kFrameSize);
  v1::RunConfig config = SmallConfig(66, "ppo_spcnn");
  config.mutable_network()->set_frame_size(kFrameSize);
  const std::string start = *(*PpoUpdater::Create(config, 2))->SaveWeights();
  for (const v1::RunConfig::Precision precision : {v1::RunConfig::FP32, v1::RunConfig::BF16}) {
    SCOPED_TRACE(v1::RunConfig::Precision_Name(precision));
    config.set_precision(precision);
    if (!PpoUpdater::Create(config, 1, "cpu", PpoUpdater::Start::kZeros).ok()) continue;  // a CPU without BF16
    const auto digest = [&](int threads) {
      const auto updater = *PpoUpdater::Create(config, threads, "cpu", PpoUpdater::Start::kZeros);
      EXPECT_TRUE(updater->Load(start, *updater->SaveOptimizer()).ok());
      EXPECT_TRUE(updater->Update(0, owned.rollout, NeverStop).ok());
      return Crc32c(*updater->SaveWeights() + *updater->SaveOptimizer());
    };
    const uint32_t one = digest(1);
    EXPECT_EQ(digest(1), one);
    EXPECT_EQ(digest(2), one);
  }
}

// A weight as large as those of WideLinear, which other products multiply: that of the patches' convolution.
TEST(PpoUpdater, UpdatesALargeWeightOfPatches) {
  constexpr int kFrameSize = 32;
  const OwnedRollout owned = RandomRollout(11, 4, kFrameSize);
  v1::RunConfig config = SmallConfig(4, "oc_sa");
  config.mutable_network()->set_frame_size(kFrameSize);
  config.mutable_network()->set_patch(kFrameSize);
  const auto updater = *PpoUpdater::Create(config, 2, "cpu", PpoUpdater::Start::kZeros);
  const AgentSpec& spec = updater->spec();
  const auto embedding = std::find_if(spec.params.begin(), spec.params.end(), [](const ParamSpec& param) {
    return param.name == "features_extractor.rsn.trafo.emb_proj.weight";
  });
  ASSERT_NE(embedding, spec.params.end());
  if (!WideLinearFits(at::empty(embedding->shape), at::kFloat)) GTEST_SKIP() << "this CPU has no kernels for it";
  std::vector<float> weights(spec.param_count);
  for (size_t i = 0; i < weights.size(); ++i) weights[i] = static_cast<float>(i % 13) * 1e-4F;
  ASSERT_TRUE(updater->Load(SaveWeights(spec, weights), *updater->SaveOptimizer()).ok());
  const absl::StatusOr<UpdateStats> stats = updater->Update(0, owned.rollout, NeverStop);
  ASSERT_TRUE(stats.ok()) << stats.status();
  const std::vector<float> updated = *LoadWeights(spec, *updater->SaveWeights());
  EXPECT_NE(updated[embedding->offset], weights[embedding->offset]);
}

TEST(PpoUpdater, StartsFromOldWeightsWithAFreshOptimiser) {
  v1::RunConfig config = SmallConfig(32);
  const auto old = *PpoUpdater::Create(config, 2);
  ASSERT_TRUE(old->Update(0, RandomRollout(11, 64).rollout, NeverStop).ok());
  config.set_seed(config.seed() + 1);
  const auto updater = *PpoUpdater::Create(config, 2);
  ASSERT_TRUE(updater->Update(0, RandomRollout(12, 64).rollout, NeverStop).ok());
  ASSERT_TRUE(updater->StartFrom(*old->SaveWeights(), *old->SaveOptimizer()).ok());
  EXPECT_TRUE(*updater->SaveWeights() == *old->SaveWeights());
  EXPECT_TRUE(*updater->SaveOptimizer() == FreshOptimizer(config));
  EXPECT_EQ(updater->optimizer_steps(), 0);
  EXPECT_EQ(updater->StartFrom(*old->SaveOptimizer(), "").code(), absl::StatusCode::kInvalidArgument);
}

TEST(PpoUpdater, TakesTheValueNormaliserOfOldWeightsIfTheyHaveOne) {
  v1::RunConfig config = SmallConfig(32);
  config.mutable_ppo()->set_value_norm_decay(0.9);
  const auto old = *PpoUpdater::Create(config, 2);
  ASSERT_TRUE(old->Update(0, RandomRollout(11, 64).rollout, NeverStop).ok());
  const auto updater = *PpoUpdater::Create(config, 2);
  ASSERT_TRUE(updater->StartFrom(*old->SaveWeights(), *old->SaveOptimizer()).ok());
  EXPECT_EQ(updater->rollout_options().value_scale.mean, old->rollout_options().value_scale.mean);
  ASSERT_TRUE(updater->StartFrom(*old->SaveWeights(), FreshOptimizer(SmallConfig(32))).ok());
  EXPECT_EQ(updater->rollout_options().value_scale.mean, 0);
}

TEST(PpoUpdater, LoadRefusesWhatIsNotTheAgentsAndKeepsItsState) {
  const auto updater = *PpoUpdater::Create(SmallConfig(32), 1);
  const std::string weights = *updater->SaveWeights();
  const std::string optimizer = *updater->SaveOptimizer();
  EXPECT_EQ(updater->Load(optimizer, optimizer).code(), absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(updater->Load(weights, weights).code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(std::string(updater->Load(weights, weights).message()),
              HasSubstr("exp_avg.features_extractor.cnn.0.weight"));
  EXPECT_TRUE(*updater->SaveWeights() == weights);
}

TEST(PpoUpdater, LoadRefusesNumbersThatNoUpdateLeaves) {
  const auto updater = *PpoUpdater::Create(SmallConfig(32), 1);
  const std::string weights = *updater->SaveWeights();
  const std::string optimizer = *updater->SaveOptimizer();
  // Both files end with the last number of their last tensor; that of the optimiser is a second moment.
  const auto with_last = [](std::string file, float number) {
    std::memcpy(&file[file.size() - sizeof(number)], &number, sizeof(number));
    return file;
  };
  const float kNan = std::numeric_limits<float>::quiet_NaN();
  EXPECT_THAT(std::string(updater->Load(with_last(weights, kNan), optimizer).message()), HasSubstr("is nan, want"));
  EXPECT_THAT(std::string(updater->StartFrom(with_last(weights, kNan), optimizer).message()),
              HasSubstr("is nan, want"));
  for (const float moment : {kNan, -1.0F}) {
    EXPECT_THAT(std::string(updater->Load(weights, with_last(optimizer, moment)).message()), HasSubstr("moments"));
  }
  EXPECT_TRUE(*updater->SaveWeights() + *updater->SaveOptimizer() == weights + optimizer);
}

TEST(PpoUpdater, AResumedRunGoesOnAsIfNeverStopped) {
  v1::RunConfig config = SmallConfig(32);
  config.mutable_ppo()->set_value_norm_decay(0.9);
  config.mutable_ppo()->set_value_norm_start(0.1);
  const OwnedRollout owned = RandomRollout(11, 64);
  const auto first = *PpoUpdater::Create(config, 2);
  EXPECT_EQ(first->rollout_options().value_scale.deviation, 0.1) << "no targets yet";
  for (int i = 0; i < 2; ++i) ASSERT_TRUE(first->Update(i, owned.rollout, NeverStop).ok());
  const auto second = *PpoUpdater::Create(config, 2, "cpu", PpoUpdater::Start::kZeros);
  ASSERT_TRUE(second->Load(*first->SaveWeights(), *first->SaveOptimizer()).ok());
  EXPECT_EQ(second->optimizer_steps(), 4);
  const ValueScale scale = second->rollout_options().value_scale;
  EXPECT_EQ(scale.mean, first->rollout_options().value_scale.mean);
  EXPECT_EQ(scale.deviation, first->rollout_options().value_scale.deviation);
  EXPECT_NEAR(scale.mean, 0.5, 0.2) << "of returns that are the sum of uniforms in 0..1 and -0.5..0.5";
  ASSERT_TRUE(second->Update(2, owned.rollout, NeverStop).ok());
  EXPECT_TRUE(*second->SaveWeights() + *second->SaveOptimizer() == TrainedState(config, 2, 3));

  const absl::Status status = second->Load(*first->SaveWeights(), FreshOptimizer(SmallConfig(32)));
  EXPECT_THAT(std::string(status.message()), HasSubstr("value_norm.mean"));
}

// The value head learns the same from returns that are a hundred times as large.
TEST(PpoUpdater, NormalisedValueLossDoesNotDependOnTheReturnsScale) {
  v1::RunConfig config = SmallConfig(32);
  config.mutable_ppo()->set_value_norm_decay(0.9);
  OwnedRollout owned = RandomRollout(11, 64);
  const UpdateStats stats = *(*PpoUpdater::Create(config, 2))->Update(0, owned.rollout, NeverStop);
  for (float& target : owned.rollout.returns) target *= 100;
  const UpdateStats scaled = *(*PpoUpdater::Create(config, 2))->Update(0, owned.rollout, NeverStop);
  EXPECT_NEAR(scaled.value_loss, stats.value_loss, stats.value_loss * 1e-4);
  EXPECT_NEAR(stats.value_loss, 1, 0.3) << "the head begins at zero";
}

// Advantages count relative to the whole rollout: neither their scale nor their mean matters, but those of a minibatch
// do.
TEST(PpoUpdater, AdvantagesMayBeNormalisedOverTheRollout) {
  const auto losses = [](bool over_rollout, int minibatch_size, float scale) {
    OwnedRollout owned = RandomRollout(11, 64);
    for (float& advantage : owned.rollout.advantages) advantage = scale * advantage + scale;
    v1::RunConfig config = SmallConfig(minibatch_size);
    config.mutable_ppo()->set_advantages_over_rollout(over_rollout);
    return (*PpoUpdater::Create(config, 2))->Update(0, owned.rollout, NeverStop)->policy_loss;
  };
  EXPECT_EQ(losses(true, 64, 1), losses(false, 64, 1)) << "one minibatch is the rollout";
  EXPECT_NEAR(losses(true, 8, 1), losses(true, 8, 10), 1e-5);
  EXPECT_GT(std::abs(losses(true, 8, 1) - losses(false, 8, 1)), 1e-4);
}

TEST(PpoUpdater, LearnsToPreferTheRewardedAction) {
  OwnedRollout owned = RandomRollout(11, 128);
  Rollout& rollout = owned.rollout;
  for (size_t i = 0; i < rollout.size(); ++i) rollout.advantages[i] = rollout.actions[i] == Action::kDo ? 1.0F : -0.1F;
  v1::RunConfig config = SmallConfig(64);
  config.mutable_ppo()->set_epochs(4);
  const auto updater = *PpoUpdater::Create(config, 2);
  UpdateStats first;
  UpdateStats last;
  for (int i = 0; i < 10; ++i) {
    last = *updater->Update(i, rollout, NeverStop);
    if (i == 0) first = last;
  }
  EXPECT_LT(last.policy_loss, first.policy_loss - 0.05);
  EXPECT_LT(last.value_loss, first.value_loss);
}

}  // namespace
}  // namespace craftfleet
