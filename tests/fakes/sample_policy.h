// Sample weights and policies for tests.

#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "common/agent/agent_spec.h"
#include "common/agent/policy.h"
#include "common/agent/weights.h"
#include "common/base/keyed_random.h"

namespace craftfleet {

// Weights of an agent as safetensors: small random numbers, so that its actions depend on its observations.
inline std::string SampleWeights(uint64_t seed, const AgentSpec& spec) {
  std::vector<float> weights(spec.param_count);
  for (size_t i = 0; i < weights.size(); ++i) {
    weights[i] = static_cast<float>(UnitInterval(KeyedBits(RandomUse::kInitialWeights, seed, i, 0)) - 0.5) * 0.2F;
  }
  return SaveWeights(spec, weights);
}

inline std::string SampleWeights(uint64_t seed, const std::string& agent = "ppo_cnn") {
  return SampleWeights(seed, *FindAgent(agent));
}

inline std::unique_ptr<const Policy> SamplePolicy(uint64_t seed, int tile = 8, const std::string& agent = "ppo_cnn") {
  return *Policy::Create(*FindAgent(agent), SampleWeights(seed, agent), tile);
}

}  // namespace craftfleet
