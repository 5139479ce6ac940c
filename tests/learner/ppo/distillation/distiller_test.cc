// Distillation within updates, on a small network.

#include "learner/ppo/distillation/distiller.h"

#include <algorithm>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <ATen/ATen.h>
#include <absl/strings/match.h>
#include <absl/strings/str_cat.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/agent/weights.h"
#include "common/base/keyed_random.h"
#include "common/config/config.h"
#include "learner/ppo/ppo_updater.h"
#include "tests/agent/stand_in_device.h"
#include "tests/fakes/status_matchers.h"
#include "tests/learner/ppo/saved_tensors.h"
#include "tests/learner/ppo/update_samples.h"

namespace craftfleet {
namespace distiller_test {

constexpr int kLanes = 2;
constexpr int kLaneSteps = 24;
constexpr int kRows = kLanes * kLaneSteps;
constexpr int kEpisode = 10;  // steps
constexpr int kFrameSize = 36;
constexpr int kFrameBytes = 3 * kFrameSize * kFrameSize;
constexpr const char* kDevices[] = {"cpu:0", kStandInDevice};

v1::RunConfig Config() {
  return ResolveRunConfig(ParseRunConfig(R"(
    agent: "achievement_distillation" seed: 7 lanes: 2
    network { extractor: CNN frame_size: 36 }
    ppo { rollout_steps: 48 minibatch_size: 16 epochs: 1 learning_rate: 1e-3 }
    distillation { every_iterations: 2 epochs: 2 minibatch_size: 6 targets: 2 })",
                                         "config")
                              .value())
      .value();
}

// A rollout with what it points to: episodes of kEpisode steps, each with two achievements, whose frames are bright
// from the step after them.
struct Sample {
  explicit Sample(int iteration, int memory_size) {
    memories.resize(static_cast<size_t>(kRows) * memory_size);
    for (int row = 0; row < kRows; ++row) {
      const int step = iteration * kLaneSteps + row % kLaneSteps + row / kLaneSteps * 3;  // lanes are out of step
      const int t = step % kEpisode;
      const auto noise = [&](int k) { return ActionNoise(5, iteration * kRows + row, k); };
      const int brightness = t > 6 ? 200 : t > 3 ? 100 : 0;
      for (int i = 0; i < kFrameBytes; ++i) {
        frames.push_back(static_cast<char>(static_cast<uint8_t>(brightness + 50 * noise(i + 9))));
      }
      if (t > 3 && memory_size > 0) memories[static_cast<size_t>(row) * memory_size + (t > 6 ? 1 : 0)] = 1;
      rollout.actions.push_back(static_cast<Action>(noise(0) * kNumActions));
      rollout.log_probs.push_back(-2.8F);
      rollout.values.push_back(static_cast<float>(noise(1)));
      rollout.advantages.push_back(static_cast<float>(noise(2)) - 0.5F);
      rollout.returns.push_back(rollout.values.back() + rollout.advantages.back());
      rollout.rewards.push_back(t == 3 || t == 6 ? 1 : 0);
      rollout.ends.push_back(t + 1 == kEpisode ? StepEnd::kTerminated : StepEnd::kNone);
    }
    for (int row = 0; row < kRows; ++row) {
      rollout.frames.push_back(reinterpret_cast<const uint8_t*>(&frames[static_cast<size_t>(row) * kFrameBytes]));
      rollout.states.push_back(memories.data() + static_cast<size_t>(row) * memory_size);
    }
  }
  Sample(const Sample&) = delete;
  Sample& operator=(const Sample&) = delete;

  std::string frames;
  std::vector<float> memories;
  Rollout rollout;
};

absl::StatusOr<UpdateStats> Update(int iteration, PpoUpdater* updater) {
  return updater->Update(iteration, Sample(iteration, updater->spec().state_size).rollout, NeverStop);
}

std::string StateOf(PpoUpdater& updater) { return *updater.SaveWeights() + *updater.SaveOptimizer(); }

// The weights of the goal predictor.
std::string PredictorOf(const PpoUpdater& updater) {
  const std::string bytes = *updater.SaveWeights();
  const SafeTensors file = *ReadSafetensors(bytes);
  std::string predictor;
  for (const SafeTensor& tensor : file.tensors) {
    if (absl::StartsWith(tensor.name, "film.") || absl::StartsWith(tensor.name, "predictor.")) {
      predictor.append(tensor.data.data(), tensor.data.size());
    }
  }
  return predictor;
}

TEST(Distiller, APhaseFollowsEveryFewIterations) {
  const auto updater = *PpoUpdater::Create(Config(), 1);
  const std::string before = PredictorOf(*updater);
  for (int i = 0; i < 4; ++i) {
    const std::string last = PredictorOf(*updater);
    const absl::StatusOr<UpdateStats> stats = Update(i, updater.get());
    ASSERT_TRUE(stats.ok()) << stats.status();
    EXPECT_EQ(stats->distillation.has_value(), i % 2 == 1) << i;
    EXPECT_EQ(PredictorOf(*updater) == last, i % 2 == 0) << "PPO does not train the predictor";
    if (!stats->distillation.has_value()) continue;
    // Of the 48 steps a lane, 3 or 4 episodes are whole. In each of 2 epochs, the 10 steps of one take two minibatches.
    EXPECT_EQ(stats->distillation->episodes, 7);
    EXPECT_EQ(stats->distillation->prediction_steps, 2 * 7 * 2);
    EXPECT_GT(stats->distillation->matching_steps, 0);
    EXPECT_LE(stats->distillation->matching_steps, 2 * 7);
    EXPECT_GT(stats->distillation->divergence, 0);
  }
  EXPECT_FALSE(PredictorOf(*updater) == before);
}

// Two updaters see the same steps, but the rewards of `changed` instead of the sample's. Returns them after PPO's
// iteration 0 and after the phase of iteration 1.
struct Pair {
  explicit Pair(const std::function<void(Rollout*)>& change) {
    for (int i = 0; i < 2; ++i) {
      Sample same(i, one->spec().state_size);
      Sample other(i, one->spec().state_size);
      change(&other.rollout);
      EXPECT_THAT(one->Update(i, same.rollout, NeverStop), IsOk());
      EXPECT_THAT(two->Update(i, other.rollout, NeverStop), IsOk());
      equal[i] = StateOf(*one) == StateOf(*two);
      equal_weights[i] = *one->SaveWeights() == *two->SaveWeights();
    }
  }
  const std::unique_ptr<PpoUpdater> one = *PpoUpdater::Create(Config(), 1);
  const std::unique_ptr<PpoUpdater> two = *PpoUpdater::Create(Config(), 1);
  bool equal[2];          // weights, optimisers and kept rollouts, after each iteration
  bool equal_weights[2];  // weights alone
};

TEST(Distiller, OtherGoalsChangeThePhaseButNotPpo) {
  // Each goal trades places with the step before it.
  const Pair pair([](Rollout* rollout) {
    for (int row = 1; row < kRows; ++row) {
      if (rollout->rewards[row] > 0) std::swap(rollout->rewards[row - 1], rollout->rewards[row]);
    }
  });
  EXPECT_TRUE(pair.equal_weights[0]) << "PPO learns from advantages and returns";
  EXPECT_FALSE(pair.equal[0]) << "the kept rollouts say which steps are goals";
  EXPECT_FALSE(pair.equal_weights[1]);
  EXPECT_FALSE(PredictorOf(*pair.one) == PredictorOf(*pair.two));
}

TEST(Distiller, OfRewardsOnlyTheUnlocksCount) {
  // Lost and won health beside an unlock.
  const Pair pair([](Rollout* rollout) {
    for (int row = 0; row < kRows; ++row) rollout->rewards[row] += row % 2 == 0 ? 0.1F : -0.1F;
  });
  EXPECT_TRUE(pair.equal[0]);
  EXPECT_TRUE(pair.equal[1]);
}

// The figures agree but for rounding, which Adam makes visible where a gradient is small: the learning rate is low, so
// that it does not grow from step to step. A wrong term would show as 10% and more.
TEST(Distiller, LearnsOnADeviceAsOnTheCpu) {
  for (const bool memory : {true, false}) {
    v1::RunConfig config = Config();
    config.mutable_network()->set_memory(memory);
    config.mutable_ppo()->set_learning_rate(1e-5);
    const auto expected = *PpoUpdater::Create(config, 1);
    const at::Tensor start = SavedTensors(*expected->SaveWeights());
    UpdateStats wanted;
    for (int i = 0; i < 2; ++i) wanted = *Update(i, expected.get());
    for (const char* device : kDevices) {
      SCOPED_TRACE(absl::StrCat(device, memory ? "" : " without memory"));
      const auto actual = *PpoUpdater::Create(config, 1, device);
      for (int i = 0; i < 2; ++i) {
        const absl::StatusOr<UpdateStats> stats = Update(i, actual.get());
        ASSERT_THAT(stats, IsOk());
        ASSERT_EQ(stats->distillation.has_value(), i == 1);
        if (i == 0) continue;
        EXPECT_EQ(stats->distillation->matching_steps, wanted.distillation->matching_steps);
        EXPECT_EQ(stats->distillation->prediction_steps, wanted.distillation->prediction_steps);
        EXPECT_NEAR(stats->distillation->matching_loss, wanted.distillation->matching_loss, 1e-3);
        EXPECT_NEAR(stats->distillation->prediction_loss, wanted.distillation->prediction_loss, 1e-3);
        EXPECT_NEAR(stats->distillation->divergence, wanted.distillation->divergence, 1e-4);
        EXPECT_NEAR(stats->distillation->value_loss, wanted.distillation->value_loss, 1e-3);
      }
      const at::Tensor weights = SavedTensors(*expected->SaveWeights());
      EXPECT_LT(ShareOfWay(SavedTensors(*actual->SaveWeights()), weights, start), 0.02);
      for (const char* adam : {"exp_avg", "matching.exp_avg", "prediction.exp_avg"}) {
        const at::Tensor moments = SavedTensors(*expected->SaveOptimizer(), adam);
        EXPECT_LT(ShareOfWay(SavedTensors(*actual->SaveOptimizer(), adam), moments, at::zeros_like(moments)), 0.02)
            << adam;
      }
      EXPECT_NEAR(actual->rollout_options().value_scale.mean, expected->rollout_options().value_scale.mean, 1e-5);
    }
  }
}

class DistillerOn : public testing::TestWithParam<const char*> {};
INSTANTIATE_TEST_SUITE_P(Devices, DistillerOn, testing::Values("cpu", kDevices[0], kDevices[1]));

TEST_P(DistillerOn, ARunResumedAfterAnyIterationEqualsTheUninterruptedOne) {
  const auto whole = *PpoUpdater::Create(Config(), 2, GetParam());
  auto resumed = *PpoUpdater::Create(Config(), 2, GetParam());
  for (int i = 0; i < 4; ++i) {
    ASSERT_TRUE(Update(i, whole.get()).ok());
    ASSERT_TRUE(Update(i, resumed.get()).ok());
    EXPECT_TRUE(StateOf(*resumed) == StateOf(*whole)) << i;
    auto next = *PpoUpdater::Create(Config(), 2, GetParam(), PpoUpdater::Start::kZeros);
    ASSERT_TRUE(next->Load(*resumed->SaveWeights(), *resumed->SaveOptimizer()).ok());
    resumed = std::move(next);
  }
}

TEST_P(DistillerOn, APhaseWithoutAGoalTakesNoStep) {
  const auto updater = *PpoUpdater::Create(Config(), 2, GetParam());
  for (int i = 0; i < 2; ++i) {
    Sample sample(i, updater->spec().state_size);
    std::fill(sample.rollout.rewards.begin(), sample.rollout.rewards.end(), 0.0F);
    const absl::StatusOr<UpdateStats> stats = updater->Update(i, sample.rollout, NeverStop);
    ASSERT_THAT(stats, IsOk());
    if (i == 0) continue;
    EXPECT_EQ(stats->distillation->episodes, 0);
    EXPECT_EQ(stats->distillation->matching_steps + stats->distillation->prediction_steps, 0);
  }
}

TEST_P(DistillerOn, AStoppedPhaseChangesNothing) {
  const auto updater = *PpoUpdater::Create(Config(), 2, GetParam());
  ASSERT_TRUE(Update(0, updater.get()).ok());
  const std::string before = StateOf(*updater);
  int asked = 0;
  const Sample sample(1, updater->spec().state_size);
  // PPO has three minibatches.
  const auto stopped = updater->Update(1, sample.rollout, [&] { return ++asked == 9; });
  EXPECT_EQ(stopped.status().code(), absl::StatusCode::kCancelled) << stopped.status();
  EXPECT_TRUE(StateOf(*updater) == before);
  const auto other = *PpoUpdater::Create(Config(), 2, GetParam());
  for (int i = 0; i < 2; ++i) ASSERT_TRUE(Update(i, other.get()).ok());
  ASSERT_TRUE(Update(1, updater.get()).ok());
  EXPECT_TRUE(StateOf(*updater) == StateOf(*other)) << "as if it had not been stopped";
}

TEST(Distiller, WithoutMemoryAPhaseSaysWhatToLowerAndLosesNothing) {
  const auto updater = *PpoUpdater::Create(Config(), 1, kStandInDevice);
  ASSERT_THAT(Update(0, updater.get()), IsOk());
  const std::string before = StateOf(*updater);
  int asked = 0;
  const auto in_the_phase = [&] {  // PPO has three minibatches
    if (++asked == 9) RunOutOfMemoryAfter(1);
    return false;
  };
  EXPECT_THAT(updater->Update(1, Sample(1, updater->spec().state_size).rollout, in_the_phase),
              StatusIs(absl::StatusCode::kResourceExhausted,
                       testing::AllOf(testing::HasSubstr("lower distillation.minibatch_size, then distillation.every"),
                                      testing::Not(testing::HasSubstr("ppo.minibatch_size")))));
  EXPECT_TRUE(StateOf(*updater) == before);
}

TEST(Distiller, PredictionIsLearned) {
  v1::RunConfig config = Config();
  config.mutable_distillation()->set_epochs(5);
  const auto updater = *PpoUpdater::Create(config, 2);
  DistillationStats first;
  DistillationStats last;
  for (int i = 0; i < 4; ++i) {
    const UpdateStats stats = *Update(i, updater.get());
    if (i == 1) first = *stats.distillation;
    if (i == 3) last = *stats.distillation;
  }
  EXPECT_LT(last.prediction_loss, first.prediction_loss);
}

TEST(Distiller, LoadRefusesAnOptimiserWithoutIt) {
  const auto updater = *PpoUpdater::Create(Config(), 1);
  v1::RunConfig plain = Config();
  plain.mutable_distillation()->set_every_iterations(0);
  const std::string before = StateOf(*updater);
  const absl::Status status = updater->Load(*updater->SaveWeights(), FreshOptimizer(plain));
  EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument);
  EXPECT_NE(status.message().find("matching.exp_avg."), absl::string_view::npos) << status;
  EXPECT_TRUE(StateOf(*updater) == before);
}

// The ablations of the paper.
TEST(Distiller, WorksWithoutMemoryAndWithoutMatching) {
  v1::RunConfig config = Config();
  config.mutable_network()->set_memory(false);
  config.mutable_distillation()->set_targets(0);
  const auto updater = *PpoUpdater::Create(config, 1);
  EXPECT_EQ(updater->spec().state_size, 0);
  ASSERT_TRUE(Update(0, updater.get()).ok());
  const absl::StatusOr<UpdateStats> stats = Update(1, updater.get());
  ASSERT_TRUE(stats.ok()) << stats.status();
  EXPECT_EQ(stats->distillation->matching_steps, 0);
  EXPECT_GT(stats->distillation->prediction_steps, 0);
}

}  // namespace distiller_test
}  // namespace craftfleet
