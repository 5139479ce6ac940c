#include "tests/agent/golden_agent.h"

#include <algorithm>
#include <cmath>
#include <fstream>
#include <utility>

#include <ATen/ATen.h>
#include <absl/strings/str_cat.h>

#include "common/agent/policy_net.h"
#include "common/base/check.h"
#include "common/base/seeds.h"
#include "tests/fakes/test_paths.h"

namespace craftfleet {

nlohmann::json ReadGolden(const std::string& file) {
  std::ifstream stream(SourcePath(absl::StrCat("tests/data/agents/", file)));
  CRAFTFLEET_CHECK(stream.good());
  return nlohmann::json::parse(stream);
}

namespace {

// The goldens' sequence u_i, i from 0, in [-1, 1).
class SignedUniforms {
 public:
  explicit SignedUniforms(const std::string& name) {
    for (const char c : name) hash_ = (hash_ ^ static_cast<unsigned char>(c)) * 0x100000001B3ULL;
  }
  double operator[](int64_t i) const {
    const uint64_t z = MixBits(hash_ + static_cast<uint64_t>(i + 1) * 0x9E3779B97F4A7C15ULL);
    return (static_cast<double>(z >> 40) - 8388608.0) / 8388608.0;
  }

 private:
  uint64_t hash_ = 0xCBF29CE484222325ULL;  // FNV-1a
};

}  // namespace

std::vector<float> GoldenWeights(const AgentSpec& spec, const nlohmann::json& golden) {
  std::vector<float> weights(spec.param_count);
  const nlohmann::json& params = golden["params"];
  CRAFTFLEET_CHECK(params.size() >= spec.params.size());
  for (const ParamSpec& param : spec.params) {
    const auto found = std::find_if(params.begin(), params.end(),
                                    [&](const nlohmann::json& other) { return other["name"] == param.name; });
    CRAFTFLEET_CHECK(found != params.end());
    double scale = (*found)["scale"];
    // The baseline's heads bear the names of wider ones; the scale is sqrt(3 / width).
    if (param.shape.size() == 2) {
      scale *= std::sqrt((*found)["shape"][1].get<double>() / static_cast<double>(param.shape[1]));
    }
    const double offset = found->value("offset", 0.0);
    const SignedUniforms u(param.name);
    for (int64_t i = 0; i < param.size; ++i) weights[param.offset + i] = static_cast<float>(offset + scale * u[i]);
  }
  return weights;
}

std::vector<float> GoldenUniforms(const std::string& tag, int64_t n, double low, double high) {
  const SignedUniforms u(tag);
  std::vector<float> values(n);
  for (int64_t i = 0; i < n; ++i) values[i] = static_cast<float>(low + (high - low) * (u[i] + 1) / 2);
  return values;
}

std::string GoldenFrames(uint32_t seed, int n, int size) {
  constexpr int kBlock = 4;
  CRAFTFLEET_CHECK(size % kBlock == 0);
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

at::Tensor AsInput(const std::string& frames, const AgentSpec& spec) {
  const int64_t n = static_cast<int64_t>(frames.size()) / spec.frame_bytes();
  at::Tensor input = at::empty({n, spec.frame_size, spec.frame_size, 3});
  std::vector<const uint8_t*> rows(n);
  for (int64_t i = 0; i < n; ++i) rows[i] = reinterpret_cast<const uint8_t*>(&frames[i * spec.frame_bytes()]);
  ScaleFrames(rows, spec.frame_bytes(), input.data_ptr<float>());
  return input;
}

GoldenAgent::GoldenAgent(const std::string& name) : golden(ReadGolden(name + ".json")) {
  absl::StatusOr<AgentSpec> published = FindAgent(name + "_published");
  spec = published.ok() ? *std::move(published) : *FindAgent(name);
  weights = GoldenWeights(spec, golden);
}

int64_t ByteSum(const std::string& frames) {
  int64_t sum = 0;
  for (const char byte : frames) sum += static_cast<unsigned char>(byte);
  return sum;
}

}  // namespace craftfleet
