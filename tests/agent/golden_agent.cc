#include "tests/agent/golden_agent.h"

#include <fstream>

#include "common/check.h"
#include "common/seeds.h"

namespace craftfleet::testing {

nlohmann::json ReadGolden(const std::string& file) {
  std::ifstream stream(std::string(CRAFTFLEET_SOURCE_DIR) + "/tests/data/agents/" + file);
  CRAFTFLEET_CHECK(stream.good());
  return nlohmann::json::parse(stream);
}

std::vector<float> GoldenWeights(const AgentSpec& spec, const nlohmann::json& golden) {
  std::vector<float> weights(spec.param_count);
  CRAFTFLEET_CHECK(golden["params"].size() == spec.params.size());
  for (size_t p = 0; p < spec.params.size(); ++p) {
    const ParamSpec& param = spec.params[p];
    const double scale = golden["params"][p]["scale"];
    uint64_t hash = 0xCBF29CE484222325ULL;  // FNV-1a
    for (const char c : param.name) hash = (hash ^ static_cast<unsigned char>(c)) * 0x100000001B3ULL;
    for (int64_t i = 0; i < param.size; ++i) {
      const uint64_t z = MixBits(hash + static_cast<uint64_t>(i + 1) * 0x9E3779B97F4A7C15ULL);
      const double u = (static_cast<double>(z >> 40) - 8388608.0) / 8388608.0;
      weights[param.offset + i] = static_cast<float>(scale * u);
    }
  }
  return weights;
}

std::string GoldenFrames(uint32_t seed, int n, int size) {
  constexpr int kBlock = 4;
  std::string frames(static_cast<size_t>(n) * size * size * 3, '\0');
  uint32_t x = seed;
  for (int frame = 0; frame < n; ++frame) {
    for (int row = 0; row < size; row += kBlock) {
      for (int column = 0; column < size; column += kBlock) {
        for (int channel = 0; channel < 3; ++channel) {
          x = x * 1664525U + 1013904223U;
          for (int pixel = 0; pixel < kBlock * kBlock; ++pixel) {
            const int at = ((frame * size + row + pixel / kBlock) * size + column + pixel % kBlock) * 3 + channel;
            frames[at] = static_cast<char>(x >> 24);
          }
        }
      }
    }
  }
  return frames;
}

}  // namespace craftfleet::testing
