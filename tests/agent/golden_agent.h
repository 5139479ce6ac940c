// The weights and frames with which the goldens in tests/data/agents were computed: formulas instead of files.

#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include <ATen/core/Tensor.h>
#include <nlohmann/json.hpp>

#include "common/agent/agent_spec.h"

namespace craftfleet {

// tests/data/agents/`file`.
nlohmann::json ReadGolden(const std::string& file);

// float[param_count], each parameter by its `name`, `scale` and `offset` in the golden, which may have more of them.
std::vector<float> GoldenWeights(const AgentSpec& spec, const nlohmann::json& golden);

// float[n] in [low, high): U(`tag`, n, low, high) of the goldens.
std::vector<float> GoldenUniforms(const std::string& tag, int64_t n, double low, double high);

// uint8[n,size,size,3]: random blocks of 4x4 pixels. `size` is a multiple of 4.
std::string GoldenFrames(uint32_t seed, int n, int size);

// `frames` as the input of a network: float[n,size,size,3] in 0..1.
at::Tensor AsInput(const std::string& frames, const AgentSpec& spec);

// One of the goldens' six agents, all of them as published, with its weights.
struct GoldenAgent {
  explicit GoldenAgent(const std::string& name);  // of the golden: "oc_sa"

  nlohmann::json golden;
  AgentSpec spec;
  std::vector<float> weights;
};

// Sum of the bytes, the goldens' checksum of frames.
int64_t ByteSum(const std::string& frames);

}  // namespace craftfleet
