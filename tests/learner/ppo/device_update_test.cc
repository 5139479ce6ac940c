// The update on a device against the CPU's: on the CPU, and on a stand-in for a GPU.

#include "learner/ppo/device_update.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <memory>
#include <ostream>
#include <stdexcept>
#include <string>
#include <vector>

#include <ATen/ATen.h>
#include <absl/strings/match.h>
#include <absl/strings/str_cat.h>
#include <gmock/gmock.h>
#include <google/protobuf/text_format.h>
#include <gtest/gtest.h>

#include "common/agent/agent_spec.h"
#include "common/agent/aligned_weights.h"
#include "common/agent/initial_weights.h"
#include "common/agent/nets/attention.h"
#include "common/agent/torch_setup.h"
#include "common/agent/weights.h"
#include "common/config/agent_presets.h"
#include "common/config/config.h"
#include "learner/ppo/device_weights.h"
#include "learner/ppo/ppo_updater.h"
#include "tests/agent/golden_agent.h"
#include "tests/agent/stand_in_device.h"
#include "tests/fakes/status_matchers.h"
#include "tests/learner/ppo/random_fragments.h"
#include "tests/learner/ppo/saved_tensors.h"
#include "tests/learner/ppo/update_samples.h"

namespace craftfleet {
namespace {

using testing::AllOf;
using testing::HasSubstr;

constexpr int kSteps = 8;      // of a fragment
constexpr int kFragments = 2;  // of a lane
constexpr int kLanes = 2;
constexpr int kRows = kSteps * kFragments * kLanes;
constexpr char kOnTheCpu[] = "cpu:0";

// SmallConfig(16) with the fields in `text`.
v1::RunConfig ConfigOf(const std::string& text) {
  v1::RunConfig config = SmallConfig(16);
  config.mutable_ppo()->set_entropy_coefficient(0.01);
  EXPECT_TRUE(google::protobuf::TextFormat::MergeFromString(text, &config)) << text;
  return config;
}

std::vector<Fragment> RandomFragments(const PpoUpdater& updater) {
  return RandomFragments(updater, kLanes, kFragments, kSteps);
}

// The initial weights, made once for each network: most of them take longer than an update.
const std::string& StartWeights(const v1::RunConfig& config) {
  static auto* const known = new std::map<std::string, std::string>;
  std::string& weights = (*known)[absl::StrCat(config.agent(), config.network().ShortDebugString())];
  if (weights.empty()) {
    const AgentSpec spec = *MakeAgentSpec(config);
    weights = SaveWeights(spec, InitialWeights(spec, config.seed()));
  }
  return weights;
}

// An updater that has run `iterations` updates.
struct Trained {
  Trained(const v1::RunConfig& config, const std::string& device, int iterations)
      : updater(*PpoUpdater::Create(config, 1, device, PpoUpdater::Start::kZeros)) {
    EXPECT_THAT(updater->Load(StartWeights(config), *updater->SaveOptimizer()), IsOk());
    const std::vector<Fragment> fragments = RandomFragments(*updater);
    for (int i = 0; i < iterations; ++i) {
      const absl::StatusOr<UpdateStats> result = updater->Update(i, RolloutOf(*updater, fragments), NeverStop);
      EXPECT_TRUE(result.ok()) << result.status();
      if (result.ok()) stats = *result;
    }
  }

  std::unique_ptr<PpoUpdater> updater;
  UpdateStats stats;  // of the last
};

// Both add the same numbers in another order, in float32: gradients, and with them Adam's moments, agree to about 1e-6
// of their norm. Where a gradient is about as small as such a difference, Adam's division by its root mean square makes
// steps of full size of it; hence 1% of the weights' way. A wrong term shows as 10% and more. `moments` is the limit
// for Adam's.
void ExpectClose(const Trained& actual, const Trained& expected, double moments, const std::string& what) {
  const auto near = [&](double a, double b, const char* name) {
    EXPECT_NEAR(a, b, 1e-4 * std::max(0.1, std::abs(b))) << what << ": " << name;
  };
  near(actual.stats.policy_loss, expected.stats.policy_loss, "policy_loss");
  near(actual.stats.value_loss, expected.stats.value_loss, "value_loss");
  near(actual.stats.entropy, expected.stats.entropy, "entropy");
  near(actual.stats.approx_kl, expected.stats.approx_kl, "approx_kl");
  near(actual.stats.gradient_norm, expected.stats.gradient_norm, "gradient_norm");
  near(actual.stats.explained_variance, expected.stats.explained_variance, "explained_variance");
  ASSERT_EQ(actual.stats.importance.has_value(), expected.stats.importance.has_value()) << what;
  if (actual.stats.importance.has_value()) {
    near(actual.stats.importance->mean, expected.stats.importance->mean, "mean importance weight");
    near(actual.stats.importance->min, expected.stats.importance->min, "least importance weight");
    near(actual.stats.importance->max, expected.stats.importance->max, "greatest importance weight");
  }
  EXPECT_NEAR(actual.stats.clip_fraction, expected.stats.clip_fraction, 1.01 / kRows) << what << ": one row's rounding";
  const std::string actual_moments = *actual.updater->SaveOptimizer();
  const std::string expected_moments = *expected.updater->SaveOptimizer();
  for (const char* name : {"exp_avg.", "exp_avg_sq."}) {
    const at::Tensor moment = SavedTensors(expected_moments, name);
    EXPECT_LT(ShareOfWay(SavedTensors(actual_moments, name), moment, at::zeros_like(moment)), moments)
        << what << ": " << name;
  }
  EXPECT_EQ(actual.updater->optimizer_steps(), expected.updater->optimizer_steps());
  const ValueScale scale = actual.updater->rollout_options().value_scale;
  const ValueScale expected_scale = expected.updater->rollout_options().value_scale;
  near(scale.mean, expected_scale.mean, "mean of returns");
  near(scale.deviation, expected_scale.deviation, "deviation of returns");
}

using Agents = testing::TestWithParam<const char*>;

void ExpectLearnsAsOnTheCpu(const v1::RunConfig& config, int iterations = 2, double moments = 1e-3) {
  const Trained expected(config, "cpu", iterations);
  const at::Tensor start = SavedTensors(StartWeights(config));
  const at::Tensor weights = SavedTensors(*expected.updater->SaveWeights());
  for (const char* device : {kOnTheCpu, kStandInDevice}) {
    const Trained actual(config, device, iterations);
    ExpectClose(actual, expected, moments, device);
    EXPECT_LT(ShareOfWay(SavedTensors(*actual.updater->SaveWeights()), weights, start), 0.01) << device;
  }
}

TEST_P(Agents, LearnOnADeviceAsOnTheCpu) { ExpectLearnsAsOnTheCpu(ConfigOf(GetParam())); }

TEST(DeviceUpdate, CorrectsLagAsOnTheCpu) {
  for (const char* text : {R"(agent: "ppo_cnn" network { frame_size: 40 } ppo { epochs: 2 value_norm_decay: 0.9 })",
                           R"(agent: "lstm_cnn" network { frame_size: 40 } ppo { recurrent_batches: SEGMENTS })",
                           R"(agent: "lstm_cnn" network { frame_size: 40 } ppo { recurrent_batches: PUBLISHED })",
                           R"(agent: "oc_sa" network { frame_size: 20 dropout: 0 })"}) {
    SCOPED_TRACE(text);
    const std::string two_epochs = absl::StrCat(text, " ppo { gamma: 0.95 gae_lambda: 0.65 epochs: 2 }");
    const v1::RunConfig corrected = ConfigOf(absl::StrCat("overlap: 1 ", two_epochs));
    // Recomputed targets follow the weights, so that the rounding of one iteration is the error of the next; and
    // rounding can move a ratio across its bound, which changes a gradient by a thousandth or two.
    constexpr double kMoments = 0.01;
    ExpectLearnsAsOnTheCpu(corrected, 1, kMoments);
    EXPECT_NE(Trained(corrected, "cpu", 1).stats.policy_loss,
              Trained(ConfigOf(two_epochs), "cpu", 1).stats.policy_loss);
  }
}

INSTANTIATE_TEST_SUITE_P(
    All, Agents,
    testing::Values(
        R"(agent: "ppo_cnn" network { frame_size: 40 } ppo { epochs: 2 })",
        R"(agent: "ppo_cnn" network { frame_size: 40 } ppo { value_norm_decay: 0.9 })",
        R"(agent: "lstm_cnn" network { frame_size: 40 } ppo { epochs: 2 recurrent_batches: SEGMENTS })",
        R"(agent: "lstm_cnn" network { frame_size: 40 critic: LSTM } ppo { recurrent_batches: SEGMENTS })",
        R"(agent: "lstm_cnn_published" network { frame_size: 40 } ppo { recurrent_batches: PUBLISHED })",
        R"(agent: "ppo_spcnn" network { frame_size: 12 })",
        R"(agent: "lstm_spcnn" network { frame_size: 12 } ppo { recurrent_batches: SEGMENTS })",
        R"(agent: "oc_sa" network { frame_size: 20 })", R"(agent: "oc_sa_published" network { frame_size: 20 })",
        R"(agent: "oc_ca" network { frame_size: 16 patch: 8 stride: 8 })",
        R"(agent: "oc_ca" network { frame_size: 32 residual_mlp: true layer_norm: true slot_competition: true })",
        R"(agent: "achievement_distillation" network { extractor: CNN frame_size: 40 })",
        R"(agent: "grid_distillation" network { frame_size: 20 })",
        R"(agent: "ppo_resnet" network { frame_size: 12 } ppo { value_norm_decay: 0.99 })"));

// bfloat16 has 8 bits: losses and the gradient's norm differ by per mille to per cent, but not by nothing.
TEST_P(Agents, LearnAlmostTheSameInBf16) {
  v1::RunConfig config = ConfigOf(GetParam());
  config.set_precision(v1::RunConfig::BF16);
  const auto refused = PpoUpdater::Create(config, 1, "cpu", PpoUpdater::Start::kZeros);
  if (!refused.ok()) GTEST_SKIP() << refused.status();
  const Trained expected(ConfigOf(GetParam()), "cpu", 1);
  for (const char* device : {"cpu", kOnTheCpu, kStandInDevice}) {
    const Trained actual(config, device, 1);
    const double norm = expected.stats.gradient_norm;
    EXPECT_NEAR(actual.stats.gradient_norm, norm, 0.1 * norm) << device;
    EXPECT_NE(actual.stats.gradient_norm, norm) << device;
    EXPECT_NEAR(actual.stats.value_loss, expected.stats.value_loss, 0.05 * expected.stats.value_loss) << device;
    EXPECT_NEAR(actual.stats.entropy, expected.stats.entropy, 0.01) << device;
  }
}

// Without and with the code for devices.
using OnTheCpu = testing::TestWithParam<const char*>;
INSTANTIATE_TEST_SUITE_P(DeviceUpdate, OnTheCpu, testing::Values("cpu", kOnTheCpu));

TEST(DeviceUpdate, RepeatsBitForBitAndResumesSo) {
  const v1::RunConfig config = ConfigOf(R"(agent: "oc_sa" network { frame_size: 20 } ppo { value_norm_decay: 0.9 })");
  const Trained once(config, kOnTheCpu, 3);
  const Trained twice(config, kOnTheCpu, 3);
  EXPECT_TRUE(*once.updater->SaveWeights() + *once.updater->SaveOptimizer() ==
              *twice.updater->SaveWeights() + *twice.updater->SaveOptimizer());
  const Trained first(config, kOnTheCpu, 2);
  const auto second = *PpoUpdater::Create(config, 1, kOnTheCpu, PpoUpdater::Start::kZeros);
  ASSERT_THAT(second->Load(*first.updater->SaveWeights(), *first.updater->SaveOptimizer()), IsOk());
  const std::vector<Fragment> fragments = RandomFragments(*second);
  ASSERT_THAT(second->Update(2, RolloutOf(*second, fragments), NeverStop), IsOk());
  EXPECT_TRUE(*second->SaveWeights() + *second->SaveOptimizer() ==
              *once.updater->SaveWeights() + *once.updater->SaveOptimizer());
}

TEST_P(OnTheCpu, AStoppedOrFailedUpdateChangesNothingAndTheNextOneGoesOn) {
  const v1::RunConfig config = ConfigOf(R"(network { frame_size: 40 } ppo { value_norm_decay: 0.9 })");
  const Trained trained(config, GetParam(), 1);
  PpoUpdater& updater = *trained.updater;
  const std::string before = *updater.SaveWeights() + *updater.SaveOptimizer();
  const std::vector<Fragment> fragments = RandomFragments(updater);
  const Rollout rollout = RolloutOf(updater, fragments);
  int asked = 0;
  EXPECT_THAT(updater.Update(1, rollout, [&] { return ++asked == 2; }),
              StatusIs(absl::StatusCode::kCancelled, HasSubstr("stopped")));
  EXPECT_EQ(asked, 2);
  EXPECT_TRUE(*updater.SaveWeights() + *updater.SaveOptimizer() == before);
  Rollout spoilt = rollout;
  spoilt.returns[20] = std::numeric_limits<float>::infinity();
  EXPECT_THAT(updater.Update(1, spoilt, NeverStop),
              StatusIs(absl::StatusCode::kDataLoss, HasSubstr("optimiser step ")));
  EXPECT_TRUE(*updater.SaveWeights() + *updater.SaveOptimizer() == before);
  ASSERT_THAT(updater.Update(1, rollout, NeverStop), IsOk());
  const Trained both(config, GetParam(), 2);
  EXPECT_TRUE(*updater.SaveWeights() + *updater.SaveOptimizer() ==
              *both.updater->SaveWeights() + *both.updater->SaveOptimizer());
}

// Adam's moments are then in the memory where the device left them.
TEST(DeviceUpdate, GoesOnAfterAStopThatNoCheckpointPreceded) {
  for (const char* text : {"", "overlap: 1 ppo { epochs: 2 }"}) {
    SCOPED_TRACE(text);
    const v1::RunConfig config = ConfigOf(absl::StrCat("network { frame_size: 40 } ", text));
    const Trained thrice(config, kOnTheCpu, 3);
    const Trained trained(config, kOnTheCpu, 0);
    PpoUpdater& updater = *trained.updater;
    const std::vector<Fragment> fragments = RandomFragments(updater);
    for (int iteration = 0; iteration < 3; ++iteration) {
      const Rollout rollout = RolloutOf(updater, fragments);
      if (iteration > 0) {
        EXPECT_TRUE(absl::IsCancelled(updater.Update(iteration, rollout, [] { return true; }).status()));
      }
      ASSERT_THAT(updater.Update(iteration, rollout, NeverStop), IsOk());
    }
    EXPECT_TRUE(*updater.SaveWeights() + *updater.SaveOptimizer() ==
                *thrice.updater->SaveWeights() + *thrice.updater->SaveOptimizer());
  }
}

TEST(DeviceUpdate, LoadsOverAnUpdateThatNoCheckpointFollowed) {
  const v1::RunConfig config = ConfigOf("network { frame_size: 40 }");
  const Trained other(config, "cpu", 1);
  const Trained trained(config, kOnTheCpu, 1);
  const std::string optimizer = *other.updater->SaveOptimizer();
  ASSERT_THAT(trained.updater->Load(*other.updater->SaveWeights(), optimizer), IsOk());
  EXPECT_TRUE(*trained.updater->SaveOptimizer() == optimizer);
}

TEST_P(OnTheCpu, RecognisesThatTrainingDiverges) {
  const auto updater = *PpoUpdater::Create(ConfigOf("ppo { learning_rate: 1  minibatch_size: 32 }"), 1, GetParam());
  const std::string before = *updater->SaveWeights() + *updater->SaveOptimizer();
  const std::vector<Fragment> fragments = RandomFragments(*updater);
  EXPECT_THAT(updater->Update(0, RolloutOf(*updater, fragments), NeverStop),
              StatusIs(absl::StatusCode::kDataLoss, HasSubstr("training diverges")));
  EXPECT_TRUE(*updater->SaveWeights() + *updater->SaveOptimizer() == before);
}

TEST(DeviceUpdate, WithoutMemoryItSaysWhatToLowerAndLosesNothing) {
  const v1::RunConfig config = ConfigOf(R"(network { frame_size: 40 })");
  const Trained trained(config, kStandInDevice, 1);
  PpoUpdater& updater = *trained.updater;
  const std::string before = *updater.SaveWeights() + *updater.SaveOptimizer();
  const std::vector<Fragment> fragments = RandomFragments(updater);
  const Rollout rollout = RolloutOf(updater, fragments);
  for (const int count : {1, 50, 200}) {  // where the rollout is sent, in the first minibatch, in a later one
    RunOutOfMemoryAfter(count);
    EXPECT_THAT(updater.Update(1, rollout, NeverStop),
                StatusIs(absl::StatusCode::kResourceExhausted,
                         AllOf(HasSubstr("lower ppo.minibatch_size"), HasSubstr("Tried to allocate 2.00 GiB"))))
        << count;
    EXPECT_TRUE(*updater.SaveWeights() + *updater.SaveOptimizer() == before) << count;
  }
  ASSERT_THAT(updater.Update(1, rollout, NeverStop), IsOk());
  const Trained both(config, kStandInDevice, 2);
  EXPECT_TRUE(*updater.SaveWeights() + *updater.SaveOptimizer() ==
              *both.updater->SaveWeights() + *both.updater->SaveOptimizer());
}

// What `call` moves.
template <typename Call>
DeviceTraffic TrafficOf(const Call& call) {
  const DeviceTraffic before = TrafficSoFar();
  call();
  const DeviceTraffic after = TrafficSoFar();
  return {after.sent - before.sent, after.fetched - before.fetched, after.read - before.read,
          after.computed - before.computed, after.awaited - before.awaited};
}

// What an update of `epochs` epochs moves.
DeviceTraffic TrafficOf(const std::string& text, int epochs) {
  v1::RunConfig config = ConfigOf(text);
  config.mutable_ppo()->set_epochs(epochs);
  return TrafficOf([&] { const Trained trained(config, kStandInDevice, 1); });
}

// The host only starts computations during an iteration, whatever the number of minibatches.
TEST_P(Agents, CopyAndWaitNeverPerMinibatch) {
  const DeviceTraffic one = TrafficOf(GetParam(), 1);
  const DeviceTraffic two = TrafficOf(GetParam(), 2);
  EXPECT_EQ(two.sent, one.sent);
  EXPECT_EQ(two.fetched, one.fetched);
  EXPECT_EQ(one.read, 0);
  EXPECT_EQ(two.read, 0);
}

TEST(DeviceUpdate, WeightsAndOptimiserStayThereUntilSomebodyWantsThem) {
  const v1::RunConfig config = ConfigOf("network { frame_size: 40 } ppo { value_norm_decay: 0.9 }");
  const Trained trained(config, kStandInDevice, 1);
  PpoUpdater& updater = *trained.updater;
  const std::vector<Fragment> fragments = RandomFragments(updater);
  const Rollout rollout = RolloutOf(updater, fragments);
  EXPECT_EQ(TrafficOf([&] { ASSERT_THAT(updater.Update(1, rollout, NeverStop), IsOk()); }).fetched, 1) << "statistics";

  const std::shared_ptr<const PolicyWeights> weights = updater.ShareWeights();
  EXPECT_EQ(updater.ShareWeights(), weights);
  const auto bytes = [&] { EXPECT_EQ(**weights->Bytes(), *updater.SaveWeights()); };
  EXPECT_EQ(TrafficOf(bytes).fetched, 1);
  EXPECT_EQ(TrafficOf(bytes).fetched, 0);
  EXPECT_EQ(TrafficOf([&] { EXPECT_THAT(updater.SaveOptimizer(), IsOk()); }).fetched, 2) << "a moment each";

  const std::string before = **weights->Bytes();
  ASSERT_THAT(updater.Update(2, rollout, NeverStop), IsOk());
  EXPECT_EQ(**weights->Bytes(), before);
  EXPECT_NE(*updater.SaveWeights(), before);
}

TEST(DeviceUpdate, ADeviceThatFailsForGoodEndsEveryLaterCall) {
  const v1::RunConfig config = ConfigOf("network { frame_size: 40 }");
  const Trained trained(config, kStandInDevice, 1);
  PpoUpdater& updater = *trained.updater;
  const std::string before = *updater.SaveWeights();
  const std::vector<Fragment> fragments = RandomFragments(updater);
  const Rollout rollout = RolloutOf(updater, fragments);
  ObserveComputations([](auto&&...) { throw std::runtime_error("CUDA error: an illegal memory access"); });
  EXPECT_THAT(updater.Update(1, rollout, NeverStop),
              StatusIs(absl::StatusCode::kUnavailable, HasSubstr("start again with --resume")));
  ObserveComputations(nullptr);
  const auto is_lost = StatusIs(absl::StatusCode::kUnavailable, HasSubstr("undoing an update: the GPU"));
  EXPECT_THAT(updater.Update(1, rollout, NeverStop), is_lost);
  EXPECT_THAT(updater.SaveOptimizer(), is_lost);
  EXPECT_EQ(*updater.SaveWeights(), before) << "which were fetched before";
  ASSERT_THAT(updater.Load(before, FreshOptimizer(config)), IsOk());
  EXPECT_THAT(updater.Update(1, rollout, NeverStop), is_lost);
}

// A GPU plans the convolutions of each number of rows anew, and sorts to add gradients row by row.
TEST(DeviceUpdate, RecurrentMinibatchesHaveFewSizesAndArePermuted) {
  for (const char* batches : {"SEGMENTS", "PUBLISHED"}) {
    SCOPED_TRACE(batches);
    int64_t convolutions = 0;
    ObserveComputations([&](absl::string_view name, const std::vector<c10::IValue>& arguments, const auto&) {
      EXPECT_FALSE(absl::StrContains(name, "index_add")) << name;
      if (name != "aten::convolution") return;
      ++convolutions;
      EXPECT_EQ(arguments[0].toTensor().size(0) % 32, 0);
    });
    const Trained trained(
        ConfigOf(
            absl::StrCat(R"(agent: "lstm_cnn" network { frame_size: 40 } ppo { recurrent_batches: )", batches, "}")),
        kStandInDevice, 1);
    ObserveComputations(nullptr);
    EXPECT_GT(convolutions, 0);
  }
}

TEST(DeviceUpdate, DropoutMasksAreTheCpus) {
  SetUpTorchThread();
  for (const double probability : {0.0, 0.1, 0.5, 0.999}) {
    for (const uint64_t key : {uint64_t{0}, uint64_t{7}, ~uint64_t{0}}) {
      const Dropout dropout{key, 5};
      const at::Tensor expected = DropoutMask({3, 2, 4, 7}, probability, 1, dropout);
      const at::Tensor actual = DropoutMaskOnDevice({3, 2, 4, 7}, probability, 1, dropout, at::kCPU);
      EXPECT_TRUE(actual.equal(expected)) << probability << " " << key;
    }
  }
}

TEST(DeviceWeights, EachParameterIsAtAMultipleOf16Bytes) {
  for (const char* agent : {"ppo_cnn", "lstm_cnn", "achievement_distillation"}) {
    SCOPED_TRACE(agent);
    const AgentSpec spec = *FindAgent(agent);
    const std::vector<float> values = GoldenUniforms("weights", spec.param_count, -1, 1);
    DeviceWeights weights;
    weights.Load(spec, values, at::kCPU);
    for (size_t i = 0; i < spec.params.size(); ++i) {
      const at::Tensor& param = weights.params.tensors[i];
      EXPECT_EQ(reinterpret_cast<uintptr_t>(param.data_ptr()) % 16, 0) << spec.params[i].name;
      EXPECT_EQ(param.flatten()[0].item<float>(), values[spec.params[i].offset]) << spec.params[i].name;
    }
    std::vector<float> back(values.size());
    Unalign(spec, Align(spec, values).data(), &back);
    EXPECT_EQ(back, values);
  }
}

}  // namespace
}  // namespace craftfleet
