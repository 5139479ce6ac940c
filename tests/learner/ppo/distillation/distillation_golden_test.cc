// Achievement distillation and its PPO baseline against the goldens: outputs, memory, and three optimiser steps of each
// kind.

#include <algorithm>
#include <cmath>
#include <map>
#include <memory>
#include <utility>

#include <ATen/ATen.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <torch/csrc/autograd/autograd.h>
#include <torch/version.h>

#include "common/agent/aligned_weights.h"
#include "common/agent/policy.h"
#include "common/agent/policy_net.h"
#include "common/agent/torch_setup.h"
#include "common/agent/weights.h"
#include "common/base/status_macros.h"
#include "common/config/agent_presets.h"
#include "common/process/cpu_pin.h"
#include "learner/ppo/device_adam.h"
#include "learner/ppo/device_weights.h"
#include "learner/ppo/distillation/device_net.h"
#include "learner/ppo/distillation/distillation_steps.h"
#include "learner/ppo/distillation/sharded_net.h"
#include "learner/ppo/gae.h"
#include "learner/ppo/ppo_loss.h"
#include "tests/agent/golden_agent.h"
#include "tests/agent/stand_in_device.h"

namespace craftfleet {
namespace {

using nlohmann::json;

constexpr int kFrameBytes = 64 * 64 * 3;
constexpr int kCode = 1024;

json Golden() { return ReadGolden("achievement_distillation.json")["network"]; }

// float[n,1024]: U(`tag`, n * 1024, -1, 1), each row scaled to length 1, those of `zero` zero.
std::vector<float> Memories(const std::string& tag, int n, const std::vector<int>& zero) {
  std::vector<float> memories = GoldenUniforms(tag, int64_t{n} * kCode, -1, 1);
  for (int row = 0; row < n; ++row) {
    float* const begin = &memories[static_cast<size_t>(row) * kCode];
    double squares = 0;
    for (int i = 0; i < kCode; ++i) squares += double{begin[i]} * begin[i];
    const bool is_zero = std::find(zero.begin(), zero.end(), row) != zero.end();
    for (int i = 0; i < kCode; ++i) begin[i] = is_zero ? 0.0F : static_cast<float>(begin[i] / std::sqrt(squares));
  }
  return memories;
}

at::Tensor Rows(std::vector<float>* values, int64_t n) {
  return at::from_blob(values->data(), {n, static_cast<int64_t>(values->size()) / n}).clone();
}

void ExpectFirst(const at::Tensor& tensor, const json& expected, double tolerance, const char* what) {
  for (size_t row = 0; row < expected.size(); ++row) {
    for (size_t i = 0; i < expected[row].size(); ++i) {
      EXPECT_NEAR(tensor[row][i].item<float>(), expected[row][i].get<double>(), tolerance) << what << row << " " << i;
    }
  }
}

TEST(DistillationGolden, OutputsOfTheAgentMatch) {
  SetUpTorchThread();
  const json golden = Golden();
  const json& forward = golden["forward"];
  const AgentSpec spec = *FindAgent("achievement_distillation");
  EXPECT_EQ(spec.param_count, golden["param_count"].get<int64_t>());
  std::vector<float> weights = GoldenWeights(spec, golden);
  const PolicyNet net(spec, PolicyNet::Use::kTraining, absl::MakeSpan(weights));
  std::vector<float> memory = Memories("memory", 4, {0});
  Segments inputs{{1, 1, 1, 1}, Rows(&memory, 4)};
  inputs.actions = at::zeros({4, kNumActions});
  for (int i = 0; i < 4; ++i) inputs.actions[i][forward["actions"][i].get<int>()] = 1;
  const std::string frames = GoldenFrames(golden["frames"]["seed"], 4, 64);
  const NetOutput output = net.Forward(AsInput(frames, spec), inputs);
  // Sums of float32 in another order than those of the golden.
  ExpectFirst(output.codes, forward["code_first8"], 2e-5, "code");
  ExpectFirst(at::log_softmax(output.logits, 1), forward["log_softmax"], 2e-5, "log_softmax");
  const at::Tensor lengths = output.predictions.norm(2, std::vector<int64_t>{1}, /*keepdim=*/true);
  ExpectFirst(output.predictions / lengths, forward["prediction_first8"], 1e-5, "prediction");
  for (int i = 0; i < 4; ++i) {
    EXPECT_NEAR(output.values[i].item<float>(), forward["value_normalised"][i].get<double>(), 1e-5);
  }
}

TEST(DistillationGolden, OutputsOfTheBaselineMatch) {
  SetUpTorchThread();
  const json golden = Golden();
  const AgentSpec spec = *FindAgent("ppo_resnet_published");
  EXPECT_EQ(spec.param_count, golden["param_count_baseline"].get<int64_t>());
  std::vector<float> weights = GoldenWeights(spec, golden);
  const PolicyNet net(spec, PolicyNet::Use::kTraining, absl::MakeSpan(weights));
  const NetOutput output = net.Forward(AsInput(GoldenFrames(golden["frames"]["seed"], 4, 64), spec));
  ExpectFirst(at::log_softmax(output.logits, 1), golden["forward"]["baseline_log_softmax"], 1e-5, "log_softmax");
  for (int i = 0; i < 4; ++i) {
    EXPECT_NEAR(output.values[i].item<float>(), golden["forward"]["baseline_value_normalised"][i].get<double>(), 1e-5);
  }
}

TEST(DistillationGolden, APolicyRemembersTheChangeOfFeatures) {
  const json golden = Golden();
  const AgentSpec spec = *FindAgent("achievement_distillation");
  const auto policy = *Policy::Create(spec, SaveWeights(spec, GoldenWeights(spec, golden)), 2);
  EXPECT_TRUE(policy->has_memory());
  EXPECT_EQ(policy->state_size(), kCode);
  const std::string frames = GoldenFrames(golden["frames"]["seed"], 4, 64);
  const auto frame = [&](int i) { return frames.substr(static_cast<size_t>(i) * kFrameBytes, kFrameBytes); };
  std::vector<float> memory(kCode, 0.5F);
  ASSERT_TRUE(policy->Remember(frame(0), frame(1), {5}, absl::MakeSpan(memory)).ok());
  const json& expected = golden["forward"]["memory_after_0_to_1_first8"];
  for (size_t i = 0; i < expected.size(); ++i) EXPECT_NEAR(memory[i], expected[i].get<double>(), 1e-5) << i;
  // Acting leaves memories as they are, and a lane's does not depend on other lanes.
  const std::vector<float> alone = memory;
  ASSERT_TRUE(policy->Act(frame(1), {5}, /*noise=*/{}, absl::MakeSpan(memory)).ok());
  EXPECT_EQ(memory, alone);
  std::vector<float> both(2 * kCode);
  ASSERT_TRUE(policy->Remember(frame(2) + frame(0), frame(3) + frame(1), {8, 5}, absl::MakeSpan(both)).ok());
  EXPECT_TRUE(std::equal(alone.begin(), alone.end(), both.begin() + kCode));
  EXPECT_EQ(policy->Remember(frame(0), frame(1) + frame(2), {5}, absl::MakeSpan(memory)).code(),
            absl::StatusCode::kInvalidArgument);
}

// A normaliser that has had one update by 1, 2, 4, -0.5.
ValueNorm UpdatedNorm() {
  ValueNorm norm;
  norm.Update({1, 2, 4, -0.5F}, 0.99);
  return norm;
}

v1::RunConfig Config(const std::string& agent, const json& part) {
  v1::RunConfig config = *AgentPreset(agent);
  config.set_agent(agent);
  config.set_lanes(2);
  config.set_gradient_shards(2);
  config.mutable_ppo()->set_learning_rate(part["learning_rate"]);
  config.mutable_ppo()->set_clip(0.2);
  config.mutable_ppo()->set_value_coefficient(0.5);
  config.mutable_ppo()->set_max_gradient_norm(0.5);
  config.mutable_ppo()->set_adam_epsilon(part["adam_epsilon"]);
  config.mutable_distillation()->set_temperature(0.1);
  return config;
}

// Of an optimiser's first step, by parameter: its first mean is a tenth of the gradient, clipped at 0.5 from `total`.
std::map<std::string, double> GradientNorms(const AgentSpec& spec, const AdamState& adam, double total) {
  std::map<std::string, double> norms;
  for (const ParamSpec& param : spec.params) {
    double squares = 0;
    for (int64_t i = 0; i < param.size; ++i) {
      squares += double{adam.exp_avg[param.offset + i]} * adam.exp_avg[param.offset + i];
    }
    norms[param.name] = std::sqrt(squares) / (0.1 * 0.5 / total);
  }
  return norms;
}

AdamState FreshAdam(const AgentSpec& spec) {
  return {0, std::vector<float>(spec.param_count), std::vector<float>(spec.param_count)};
}

// Relative, for norms of gradients; `step` is 0 for the first. The same formulas in double precision agree with the
// golden to 2e-6. Sums that round more than they must would show: a ReLU whose input comes out on the other side of
// zero changes norms by a thousandth. In later steps weights differ, as Adam divides small gradients by themselves.
// Convolutions round more in LibTorch 2, and in LibTorch 1.13 on a CPU without AVX-512. In both norms differ by up to
// 5.9e-3, in steps which have few rows.
double NormTolerance(size_t step) {
  if (TORCH_VERSION_MAJOR >= 2 || !CheckCpu(v1::RunConfig::AVX512).ok()) return 1e-2;
  return step == 0 ? 1e-4 : 1e-3;
}

void ExpectNorms(const std::map<std::string, double>& norms, const json& expected) {
  for (const auto& [name, value] : norms) {
    const double known = expected.contains(name) ? expected[name].get<double>() : 0;
    EXPECT_NEAR(value, known, known * NormTolerance(0)) << name;
  }
}

// Three of PPO's steps on one minibatch, whose advantages are normalised already.
void ExpectPpoSteps(const std::string& agent, const json& part, const json& of_agent, std::vector<float> memories) {
  SetUpTorchThread();
  const AgentSpec spec = *FindAgent(agent);
  std::vector<float> weights = GoldenWeights(spec, Golden());
  PolicyNet net(spec, PolicyNet::Use::kTraining, absl::MakeSpan(weights));
  v1::PpoConfig config = Config(agent, part).ppo();
  config.set_entropy_coefficient(0.01);
  const int n = part["n"];
  const at::Tensor frames = AsInput(GoldenFrames(part["frames_seed"], n, 64), spec);
  Segments inputs;
  if (!memories.empty()) inputs.states = Rows(&memories, n);
  std::vector<Action> actions;
  for (const int action : part["actions"]) actions.push_back(static_cast<Action>(action));
  const auto log_probs = of_agent["old_log_prob"].get<std::vector<float>>();
  const auto advantages = part["advantages"].get<std::vector<float>>();
  ValueNorm norm = UpdatedNorm();
  AdamState adam = FreshAdam(spec);
  WorkerPool workers(1, SetUpTorchThread);
  for (size_t i = 0; i < of_agent["steps"].size(); ++i) {
    const json& step = of_agent["steps"][i];
    auto returns = part["returns"].get<std::vector<float>>();
    norm.Update(returns, 0.99);
    for (float& target : returns) target = norm.Scale().Normalise(target);
    const NetOutput output = net.Forward(frames, inputs);
    const at::Tensor by_logits = at::empty_like(output.logits);
    const at::Tensor by_values = at::empty_like(output.values);
    const auto span = [](const at::Tensor& tensor) { return absl::MakeSpan(tensor.data_ptr<float>(), tensor.numel()); };
    const PpoLossSums sums =
        PpoLoss(span(output.logits), span(output.values), {actions, log_probs, advantages, returns}, config, n,
                span(by_logits), span(by_values));
    net.ClearGradients();
    torch::autograd::backward({output.logits, output.values}, {by_logits, by_values});
    const double total = step["grad_norm_total"];
    const double tolerance = i == 0 ? 1e-5 : 1e-3;
    EXPECT_NEAR(sums.policy_loss / n, step["policy_loss"].get<double>(), tolerance) << i;
    EXPECT_NEAR(sums.value_loss / n, step["value_loss"].get<double>(), tolerance) << i;
    EXPECT_NEAR(sums.entropy / n, step["entropy"].get<double>(), tolerance) << i;
    EXPECT_NEAR(norm.Scale().mean, step["normaliser"]["mean"].get<double>(), 1e-6) << i;
    const ShardGradient gradient = net.gradients();
    const double norm_before_clipping = AdamStep(config, {gradient}, absl::MakeSpan(weights), &adam, &workers);
    EXPECT_NEAR(norm_before_clipping, total, total * NormTolerance(i)) << i;
    if (i == 0) ExpectNorms(GradientNorms(spec, adam, total), step["grad_norms"]);
  }
}

TEST(DistillationGolden, PpoStepsOfTheAgentMatch) {
  const json part = Golden()["ppo_minibatch"];
  ExpectPpoSteps("achievement_distillation", part, part["agent"], Memories("memory8", 8, {0, 5}));
}

TEST(DistillationGolden, PpoStepsOfTheBaselineMatch) {
  const json part = Golden()["ppo_minibatch"];
  ExpectPpoSteps("ppo_resnet_published", part, part["baseline"], {});
}

// Two lanes of five steps, fragments of five: values as they are, a death each.
TEST(DistillationGolden, AdvantagesAreNormalisedOverAllLanes) {
  const json golden = ReadGolden("achievement_distillation.json")["rollout"];
  std::vector<float> all;
  std::vector<float> expected;
  for (size_t lane = 0; lane < 2; ++lane) {
    const auto rewards = golden["rewards"][lane].get<std::vector<float>>();
    auto values = golden["values"][lane].get<std::vector<float>>();
    const float bootstrap = values.back();
    values.pop_back();
    std::vector<StepEnd> ends;
    for (const int end : golden["ends_after"][lane]) ends.push_back(end == 1 ? StepEnd::kTerminated : StepEnd::kNone);
    std::vector<float> advantages(5);
    std::vector<float> returns(5);
    ComputeGae({rewards, values, ends, {}, bootstrap}, {golden["gamma"], golden["gae_lambda"], true},
               absl::MakeSpan(advantages), absl::MakeSpan(returns));
    for (size_t t = 0; t < 5; ++t) {
      EXPECT_NEAR(advantages[t], golden["advantages"][lane][t].get<double>(), 1e-6);
      EXPECT_NEAR(returns[t], golden["returns"][lane][t].get<double>(), 1e-6);
      expected.push_back(golden["normalised"][lane][t].get<float>());
    }
    all.insert(all.end(), advantages.begin(), advantages.end());
  }
  Normalise(absl::MakeSpan(all));
  for (size_t i = 0; i < all.size(); ++i) EXPECT_NEAR(all[i], expected[i], 1e-6) << i;
}

// Two lanes of seven steps: the source episode has steps 0..5 of the first, the target steps 0..4 of the second.
class DistillationStepsGolden : public testing::TestWithParam<const char*> {  // the device
 protected:
  static constexpr int kLaneSteps = 7;

  DistillationStepsGolden()
      : golden_(Golden()),
        prediction_(golden_["prediction_step"]),
        config_(Config("achievement_distillation", prediction_)),
        spec_(*MakeAgentSpec(config_)),
        weights_(GoldenWeights(spec_, golden_)),
        rollouts_(2, kFrameBytes, kCode),
        workers_(2, SetUpTorchThread),
        net_(MakeNet(GetParam())),
        steps_(spec_, config_, &rollouts_, net_.get()) {
    SetUpTorchThread();
    rollouts_.Add(0, MakeRollout());
    for (int t = 0; t < 6; ++t) source_.rows.push_back(t);
    for (int t = 0; t < 5; ++t) target_.rows.push_back(kLaneSteps + t);
    source_.goals = prediction_["goals"].get<std::vector<int>>();
    target_.goals = golden_["matching_step"]["target"]["goals"].get<std::vector<int>>();
    EXPECT_TRUE(net_->Begin(&rollouts_).ok());
    std::vector<float> old_logits = GoldenUniforms("old_logits", 6 * kNumActions, -1, 1);
    old_logits.resize(2 * kLaneSteps * kNumActions);
    EXPECT_TRUE(net_->SetOldLogits(std::move(old_logits)).ok());
  }

  std::unique_ptr<DistillationNet> MakeNet(const std::string& device) {
    adams_ = {FreshAdam(spec_), FreshAdam(spec_)};
    if (device == "cpu") {
      return std::make_unique<ShardedNet>(spec_, config_, absl::MakeSpan(weights_), &adams_, &workers_);
    }
    device_weights_.Load(spec_, weights_, at::Device(device));
    const std::vector<float> zeros = Align(spec_, adams_.matching.exp_avg);  // as all moments begin
    for (DeviceAdam* adam : {&device_matching_, &device_prediction_}) adam->Load({0, zeros, zeros}, at::Device(device));
    return std::make_unique<DeviceNet>(spec_, at::Device(device), &device_weights_, &device_matching_,
                                       &device_prediction_);
  }

  // The optimiser of `loss` now.
  AdamState AdamOf(DistillationLoss loss) const {
    const bool matches = loss == DistillationLoss::kMatching;
    if (std::string(GetParam()) == "cpu") return matches ? adams_.matching : adams_.prediction;
    const DeviceAdam& adam = matches ? device_matching_ : device_prediction_;
    const at::Tensor moment = adam.exp_avg().cpu();
    AdamState state{adam.steps(), std::vector<float>(spec_.param_count), {}};
    Unalign(spec_, moment.data_ptr<float>(), &state.exp_avg);
    return state;
  }

  Rollout MakeRollout() {
    frames_ = GoldenFrames(prediction_["frames_seed"], 6, 64) + std::string(kFrameBytes, '\0') +
              GoldenFrames(golden_["matching_step"]["target"]["frames_seed"], 5, 64) +
              std::string(2 * kFrameBytes, '\0');
    memory_a_ = Memories("memory_a", 1, {});
    memory_b_ = Memories("memory_b", 1, {});
    Rollout rollout;
    for (int row = 0; row < 2 * kLaneSteps; ++row) {
      const bool in_source = row < 6;
      rollout.frames.push_back(reinterpret_cast<const uint8_t*>(&frames_[static_cast<size_t>(row) * kFrameBytes]));
      rollout.actions.push_back(static_cast<Action>(in_source ? prediction_["actions"][row].get<int>() : 0));
      rollout.returns.push_back(in_source ? prediction_["returns"][row].get<float>() : 0);
      rollout.rewards.push_back(in_source && prediction_["unlocked"][row] == 1 ? 1 : 0);
      rollout.ends.push_back(StepEnd::kNone);
      rollout.states.push_back(row == 5 ? memory_b_.data() : row >= 2 && row < 5 ? memory_a_.data() : nullptr);
    }
    return rollout;
  }

  // Takes the golden's steps with `take`.
  template <typename Take>
  void ExpectSteps(const json& part, DistillationLoss loss, const Take& take) {
    ValueNorm norm = UpdatedNorm();
    for (size_t i = 0; i < part["steps"].size(); ++i) {
      const json& step = part["steps"][i];
      const absl::Status taken = take(&norm);
      ASSERT_TRUE(taken.ok()) << taken;
      const absl::StatusOr<DistillationLosses> losses = net_->TakeLosses(loss);
      ASSERT_TRUE(losses.ok()) << losses.status();
      const double tolerance = i == 0 ? 1e-5 : 1e-3;
      EXPECT_NEAR(losses->contrastive, step["contrastive"].get<double>(), tolerance) << i;
      EXPECT_NEAR(losses->divergence, step["kl"].get<double>(), tolerance) << i;
      EXPECT_NEAR(losses->value, step["value"].get<double>(), tolerance) << i;
      const double total = step["grad_norm_total"];
      EXPECT_NEAR(losses->gradient_norm, total, total * NormTolerance(i)) << i;
      EXPECT_NEAR(norm.Scale().mean, step["normaliser"]["mean"].get<double>(), 1e-6) << i;
      EXPECT_NEAR(norm.Scale().deviation, step["normaliser"]["deviation"].get<double>(), 1e-6) << i;
      if (i == 0) ExpectNorms(GradientNorms(spec_, AdamOf(loss), total), step["grad_norms"]);
    }
    EXPECT_EQ(AdamOf(loss).steps, static_cast<int64_t>(part["steps"].size()));
  }

  const json golden_;
  const json prediction_;
  const v1::RunConfig config_;
  const AgentSpec spec_;
  std::vector<float> weights_;
  std::string frames_;
  std::vector<float> memory_a_, memory_b_;
  KeptRollouts rollouts_;
  WorkerPool workers_;
  DistillationAdams adams_;
  DeviceWeights device_weights_;
  DeviceAdam device_matching_{config_.ppo()};
  DeviceAdam device_prediction_{config_.ppo()};
  const std::unique_ptr<DistillationNet> net_;
  DistillationSteps steps_;
  KeptEpisode source_, target_;
};

INSTANTIATE_TEST_SUITE_P(Devices, DistillationStepsGolden, testing::Values("cpu", "cpu:0", kStandInDevice));

TEST_P(DistillationStepsGolden, PredictionStepsMatch) {
  PredictionBatch batch{&source_, {0, 1, 2, 3, 4, 5}, prediction_["negatives"].get<std::vector<int>>()};
  ExpectSteps(prediction_, DistillationLoss::kPrediction, [&](ValueNorm* norm) { return steps_.Predict(batch, norm); });
}

TEST_P(DistillationStepsGolden, MatchingStepsMatch) {
  const json& matching = golden_["matching_step"];
  MatchingBatch batch;
  batch.source = &source_;
  for (size_t i = 0; i < matching["pairs_used"].size(); ++i) {
    const json& pair = matching["pairs_used"][i];
    batch.goals.push_back({source_.goals[pair[0].get<int>()], pair[1].get<int>(), matching["negatives"][i].get<int>()});
  }
  batch.kept = matching["kept_steps"].get<std::vector<int>>();
  ExpectSteps(matching, DistillationLoss::kMatching, [&](ValueNorm* norm) -> absl::Status {
    CRAFTFLEET_RETURN_IF_ERROR(steps_.ChangesAtGoals({&target_}).status());
    return steps_.Match(batch, norm);
  });
}

TEST_P(DistillationStepsGolden, ChangesAtGoalsGiveTheGoldensCost) {
  const GoalChanges changes = *steps_.ChangesAtGoals({&source_, &target_});
  const json& cost = golden_["matching_step"]["cost"];
  const auto source_goals = static_cast<int>(cost.size());
  EXPECT_THAT(changes.first, testing::ElementsAre(0, source_goals, source_goals + static_cast<int>(cost[0].size())));
  for (size_t i = 0; i < cost.size(); ++i) {
    for (size_t j = 0; j < cost[i].size(); ++j) {
      const float* const source = &changes.values[i * kCode];
      const float* const target = &changes.values[(cost.size() + j) * kCode];
      double product = 0;
      for (int k = 0; k < kCode; ++k) product += double{source[k]} * target[k];
      EXPECT_NEAR(1 - product, cost[i][j].get<double>(), 1e-5) << i << " " << j;
    }
  }
}

}  // namespace
}  // namespace craftfleet
