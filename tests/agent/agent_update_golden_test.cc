// Three optimiser steps on one minibatch, against the goldens of the feed-forward agents (tests/data/agents).

#include <algorithm>
#include <cmath>
#include <string>

#include <ATen/ATen.h>
#include <gtest/gtest.h>
#include <torch/csrc/autograd/autograd.h>

#include "common/agent/categorical.h"
#include "common/agent/policy_net.h"
#include "common/agent/torch_setup.h"
#include "common/base/worker_pool.h"
#include "learner/ppo/adam.h"
#include "learner/ppo/ppo_loss.h"
#include "tests/agent/golden_agent.h"

namespace craftfleet {
namespace {

// Runs consecutive optimiser steps on the goldens' minibatch.
class Trainee {
 public:
  Trainee(GoldenAgent* agent, const nlohmann::json& batch)
      : net_(agent->spec, PolicyNet::Use::kTraining, absl::MakeSpan(agent->weights)),
        weights_(absl::MakeSpan(agent->weights)),
        adam_{0, std::vector<float>(agent->weights.size()), std::vector<float>(agent->weights.size())} {
    const std::string frames = GoldenFrames(batch["frames_seed"], batch["n"], agent->spec.frame_size);
    EXPECT_EQ(ByteSum(frames), batch["frames_byte_sum"]);
    input_ = AsInput(frames, agent->spec);
    for (const int action : batch["actions"]) actions_.push_back(static_cast<Action>(action));
    log_probs_ = batch["old_log_prob"].get<std::vector<float>>();
    advantages_ = batch["advantages"].get<std::vector<float>>();
    returns_ = batch["returns"].get<std::vector<float>>();
    Normalise(absl::MakeSpan(advantages_));
  }

  // Computes the losses as means and updates gradients().
  PpoLossSums Backward() {
    output_ = net_.Forward(input_);
    const int n = static_cast<int>(actions_.size());
    const at::Tensor by_logits = at::empty_like(output_.logits);
    const at::Tensor by_values = at::empty_like(output_.values);
    PpoLossSums sums =
        PpoLoss(Floats(output_.logits), Floats(output_.values), {actions_, log_probs_, advantages_, returns_}, {}, n,
                Floats(by_logits), Floats(by_values));
    net_.ClearGradients();
    torch::autograd::backward({output_.logits, output_.values}, {by_logits, by_values});
    for (double* sum : {&sums.policy_loss, &sums.value_loss, &sums.entropy, &sums.approx_kl, &sums.clipped}) *sum /= n;
    return sums;
  }

  // Returns the gradient's norm before clipping.
  double Step() {
    AdamOptions options;
    options.learning_rate = 1e-4;
    options.epsilon = 1e-5;
    options.max_gradient_norm = 0.5;
    return AdamStep(options, {net_.gradients()}, weights_, &adam_, &workers_);
  }

  std::vector<double> gradient_norms() {
    std::vector<double> norms;
    for (const absl::Span<float> gradient : net_.gradients()) {
      double squares = 0;
      for (const float x : gradient) squares += double{x} * x;
      norms.push_back(std::sqrt(squares));
    }
    return norms;
  }
  float value(size_t row) const { return output_.values.data_ptr<float>()[row]; }
  Categorical odds(size_t row) const { return Categorical(output_.logits.data_ptr<float>() + row * kNumActions); }
  double log_prob(size_t row) const { return odds(row).log_probs[static_cast<int>(actions_[row])]; }

 private:
  static absl::Span<float> Floats(const at::Tensor& x) { return absl::MakeSpan(x.data_ptr<float>(), x.numel()); }

  PolicyNet net_;
  absl::Span<float> weights_;
  AdamState adam_;
  WorkerPool workers_{1, SetUpTorchThread};
  at::Tensor input_;
  std::vector<Action> actions_;
  std::vector<float> log_probs_, advantages_, returns_;
  PolicyNet::Output output_;
};

void ExpectClose(double actual, const nlohmann::json& expected, double tolerance, const std::string& what) {
  const double value = expected.get<double>();
  EXPECT_NEAR(actual, value, tolerance * std::max(1.0, std::abs(value))) << what;
}

// Compares what the goldens have only for the first step: each row and each parameter's gradient.
void ExpectRowsAndGradients(Trainee* trainee, const AgentSpec& spec, const nlohmann::json& step) {
  for (size_t row = 0; row < step["values"].size(); ++row) {
    ExpectClose(trainee->value(row), step["values"][row], 2e-5, "value");
    ExpectClose(trainee->log_prob(row), step["log_prob"][row], 2e-5, "log_prob");
    ExpectClose(trainee->odds(row).Entropy(), step["entropy"][row], 2e-5, "entropy");
  }
  const std::vector<double> norms = trainee->gradient_norms();
  ASSERT_EQ(norms.size(), step["grad_norms"].size());
  for (size_t p = 0; p < norms.size(); ++p) {
    const double expected = step["grad_norms"][spec.params[p].name];
    EXPECT_NEAR(norms[p], expected, 1e-3 * expected) << spec.params[p].name;
  }
}

class AgentUpdateGolden : public testing::TestWithParam<const char*> {};

TEST_P(AgentUpdateGolden, OptimiserStepsOnOneMinibatchMatch) {
  SetUpTorchThread();
  GoldenAgent agent(GetParam());
  const nlohmann::json& batch = agent.golden["ppo_minibatch"];
  Trainee trainee(&agent, batch);
  for (size_t i = 0; i < batch["steps"].size(); ++i) {
    SCOPED_TRACE(i);
    const nlohmann::json& step = batch["steps"][i];
    const PpoLossSums means = trainee.Backward();
    // The first step compares outputs; the later ones follow Adam, which divides small gradients by themselves.
    const double tolerance = i == 0 ? 2e-5 : 1e-2;
    ExpectClose(means.policy_loss, step["policy_loss"], tolerance, "policy_loss");
    ExpectClose(means.value_loss, step["value_loss"], tolerance, "value_loss");
    ExpectClose(-means.entropy, step["entropy_loss"], tolerance, "entropy_loss");
    ExpectClose(means.policy_loss + 0.5 * means.value_loss, step["total"], tolerance, "total");
    ExpectClose(means.approx_kl, step["approx_kl"], tolerance, "approx_kl");
    ExpectClose(means.clipped, step["clip_fraction"], i == 0 ? 0 : 0.0626, "clip_fraction");
    if (i == 0) ExpectRowsAndGradients(&trainee, agent.spec, step);
    // The goldens sum 134 million squares in single precision, 0.7% short of their own parts.
    const double expected_norm = step["grad_norm_total"];
    EXPECT_NEAR(trainee.Step(), expected_norm, 1e-2 * expected_norm);
  }
  const nlohmann::json& after = batch["after"];
  const PpoLossSums means = trainee.Backward();
  ExpectClose(means.policy_loss + 0.5 * means.value_loss, after["total"], 1e-2, "total");
  for (int row = 0; row < batch["n"]; ++row) {
    ExpectClose(trainee.value(row), after["values"][row], 1e-2, "value");
    ExpectClose(trainee.log_prob(row), after["log_prob"][row], 1e-2, "log_prob");
  }
}

INSTANTIATE_TEST_SUITE_P(FeedForward, AgentUpdateGolden, testing::Values("ppo_cnn", "ppo_spcnn", "oc_sa", "oc_ca"),
                         [](const auto& info) { return std::string(info.param); });

}  // namespace
}  // namespace craftfleet
