// The weights and frames that the goldens in tests/data/agents were made with: formulas instead of files.

#ifndef CRAFTFLEET_TESTS_AGENT_GOLDEN_AGENT_H_
#define CRAFTFLEET_TESTS_AGENT_GOLDEN_AGENT_H_

#include <cstdint>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include "common/agent/agent_spec.h"

namespace craftfleet::testing {

// tests/data/agents/`file`.
nlohmann::json ReadGolden(const std::string& file);

// float[param_count], each parameter by its `name` and `scale` in the golden.
std::vector<float> GoldenWeights(const AgentSpec& spec, const nlohmann::json& golden);

// uint8[n,size,size,3]: random blocks of 4x4 pixels.
std::string GoldenFrames(uint32_t seed, int n, int size);

}  // namespace craftfleet::testing

#endif  // CRAFTFLEET_TESTS_AGENT_GOLDEN_AGENT_H_
