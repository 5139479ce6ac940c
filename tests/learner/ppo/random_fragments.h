// Fragments of random steps, for updates whose results are compared.

#pragma once

#include <string>
#include <vector>

#include <absl/strings/str_cat.h>

#include "common/base/keyed_random.h"
#include "learner/ppo/ppo_updater.h"
#include "tests/agent/golden_agent.h"

namespace craftfleet {

// `lanes` times `fragments` fragments of `steps` steps for the updater's agent, lane after lane; episodes end at
// random.
inline std::vector<Fragment> RandomFragments(const PpoUpdater& updater, int lanes, int fragments, int steps) {
  const AgentSpec& spec = updater.spec();
  const bool every_state = updater.rollout_options().every_state;
  std::vector<Fragment> result;
  for (int i = 0; i < lanes * fragments; ++i) {
    Fragment& fragment = result.emplace_back();
    fragment.lane = i / fragments;
    const int size = (spec.frame_size + 3) / 4 * 4;  // theirs is a multiple of 4
    fragment.frames = GoldenFrames(100 + i, steps, size).substr(0, steps * spec.frame_bytes());
    fragment.states = GoldenUniforms(absl::StrCat("states", i), (every_state ? steps : 1) * spec.state_size, -0.5, 0.5);
    for (int step = 0; step < steps; ++step) {
      const auto uniform = [&](int k) { return static_cast<float>(ActionNoise(5, i * steps + step, k)); };
      fragment.actions.push_back(static_cast<char>(uniform(0) * kNumActions));
      fragment.log_probs.push_back(-2.8F + 0.3F * (uniform(1) - 0.5F));
      fragment.values.push_back(uniform(2));
      fragment.rewards.push_back(uniform(3));
      fragment.ends.push_back(uniform(4) < 0.2 ? StepEnd::kTerminated : StepEnd::kNone);
    }
  }
  return result;
}

}  // namespace craftfleet
