// Configurations of updates to test with, and what to look at afterwards.

#pragma once

#include <cmath>
#include <cstring>
#include <map>
#include <string>
#include <vector>

#include <absl/strings/match.h>
#include <absl/types/span.h>
#include <gtest/gtest.h>

#include "common/agent/policy.h"
#include "common/agent/safetensors.h"
#include "common/base/keyed_random.h"
#include "craftfleet/v1/config.pb.h"
#include "learner/ppo/ppo_updater.h"
#include "tests/agent/golden_agent.h"

namespace craftfleet {

inline bool NeverStop() { return false; }

inline v1::RunConfig SmallConfig(int minibatch_size, const std::string& agent = "ppo_cnn") {
  v1::RunConfig config;
  config.set_agent(agent);
  config.set_seed(7);
  config.set_gradient_shards(2);
  v1::PpoConfig* ppo = config.mutable_ppo();
  ppo->set_minibatch_size(minibatch_size);
  ppo->set_epochs(1);
  ppo->set_learning_rate(1e-4);
  ppo->set_clip(0.2);
  ppo->set_value_norm_start(1);
  ppo->set_value_coefficient(0.5);
  ppo->set_max_gradient_norm(0.5);
  ppo->set_adam_epsilon(1e-5);
  return config;
}

// Fragments that the updater's weights play, lane after lane, on random frames; episodes end at random.
inline std::vector<Fragment> PlayFragments(const PpoUpdater& updater, int lanes, int fragments, int steps) {
  const AgentSpec& spec = updater.spec();
  const bool every_state = updater.rollout_options().every_state;
  const auto policy = *Policy::Create(spec, *updater.SaveWeights(), 1);
  std::vector<Fragment> played;
  for (int lane = 0; lane < lanes; ++lane) {
    const std::string frames = GoldenFrames(100 + lane, fragments * steps, spec.frame_size);
    std::vector<float> state(spec.state_size);
    for (int step = 0; step < fragments * steps; ++step) {
      const auto uniform = [&](int k) { return ActionNoise(5, lane * 1000 + step, k); };
      const bool begins = step % steps == 0;
      if (begins) played.emplace_back().lane = lane;
      Fragment& fragment = played.back();
      if (begins || every_state) fragment.states.insert(fragment.states.end(), state.begin(), state.end());
      const std::string frame = frames.substr(step * spec.frame_bytes(), spec.frame_bytes());
      const ActResult act = *policy->Act(frame, {0}, {uniform(0)}, absl::MakeSpan(state));
      if (begins && step > 0) played[played.size() - 2].bootstrap_value = act.values[0];
      fragment.frames += frame;
      fragment.actions.push_back(static_cast<char>(act.actions[0]));
      fragment.log_probs.push_back(act.log_probs[0]);
      fragment.values.push_back(act.values[0]);
      fragment.rewards.push_back(static_cast<float>(uniform(1)));
      fragment.ends.push_back(uniform(2) < 0.1 ? StepEnd::kTerminated : StepEnd::kNone);
      if (fragment.ends.back() != StepEnd::kNone) state.assign(state.size(), 0);
    }
  }
  return played;
}

// The fragments must outlive it.
inline Rollout RolloutOf(const PpoUpdater& updater, const std::vector<Fragment>& fragments) {
  Rollout rollout;
  for (const Fragment& fragment : fragments) AppendFragment(fragment, updater.rollout_options(), &rollout);
  return rollout;
}

// An optimiser that has not stepped yet, for Load.
inline std::string FreshOptimizer(const v1::RunConfig& config) {
  return *(*PpoUpdater::Create(config, 1, "cpu", PpoUpdater::Start::kZeros))->SaveOptimizer();
}

// The L2 norm of each parameter's gradient in the optimiser's first step, whose norm in all was `norm`, clipped at 0.5.
inline std::map<std::string, double> FirstGradientNorms(PpoUpdater& updater, double norm) {
  const std::string bytes = *updater.SaveOptimizer();
  const SafeTensors state = *ReadSafetensors(bytes);
  // Adam's first mean is (1 - beta1) * the clipped gradient.
  const double scale = 0.1 * 0.5 / norm;
  std::map<std::string, double> norms;
  for (const SafeTensor& tensor : state.tensors) {
    if (!absl::StartsWith(tensor.name, "exp_avg.")) continue;
    double squares = 0;
    for (size_t at = 0; at < tensor.data.size(); at += sizeof(float)) {
      float value = 0;
      std::memcpy(&value, tensor.data.data() + at, sizeof(float));
      squares += double{value} * value;
    }
    norms[std::string(tensor.name.substr(tensor.name.find('.') + 1))] = std::sqrt(squares) / scale;
  }
  return norms;
}

}  // namespace craftfleet
