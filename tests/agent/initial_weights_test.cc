#include "common/agent/initial_weights.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <string>
#include <vector>

#include <gtest/gtest.h>

namespace craftfleet {
namespace {

AgentSpec OneLayer(int64_t outputs, int64_t inputs, double gain) {
  AgentSpec spec;
  spec.param_count = outputs * inputs + outputs;
  spec.params = {{"layer.weight", {outputs, inputs}, 0, outputs * inputs, {ParamInit::Kind::kOrthogonal, gain}},
                 {"layer.bias", {outputs}, outputs * inputs, outputs, {}}};
  return spec;
}

// Rows, or columns where there are fewer, are orthonormal times the gain. Thousands of rows are orthonormalised in
// blocks, and square matrices twice: the result must not depend on the blocks' edges.
TEST(InitialWeights, AreOrthogonalScaledByGainWithZeroBiases) {
  for (const AgentSpec& spec :
       {*FindAgent("ppo_cnn"), OneLayer(5, 5, 2.0), OneLayer(1, 9, 1.0), OneLayer(9, 3, 1.0), OneLayer(19, 300, 1.0),
        OneLayer(16, 128, 1.0), OneLayer(129, 129, 1.0), OneLayer(3, 1000, 1.0)}) {
    const std::vector<float> weights = InitialWeights(spec, 3);
    const int64_t step = spec.params.size() > 2 ? 7 : 1;
    for (const ParamSpec& param : spec.params) {
      const float* weight = &weights[param.offset];
      if (param.init.kind == ParamInit::Kind::kConstant) {
        for (int64_t i = 0; i < param.size; ++i) ASSERT_EQ(weight[i], 0) << param.name;
        continue;
      }
      const int64_t rows = param.shape[0];
      const int64_t columns = param.size / rows;
      const bool is_tall = rows > columns;
      const auto at = [&](int64_t a, int64_t k) { return weight[is_tall ? k * columns + a : a * columns + k]; };
      for (int64_t a = 0; a < std::min(rows, columns); a += step) {
        for (int64_t b = 0; b <= a; b += step) {
          double dot = 0;
          for (int64_t k = 0; k < std::max(rows, columns); ++k) dot += double{at(a, k)} * at(b, k);
          ASSERT_NEAR(dot / (param.init.scale * param.init.scale), a == b ? 1 : 0, 1e-6)
              << param.name << " of " << rows << "x" << columns << ": " << a << " " << b;
        }
      }
    }
  }
}

TEST(InitialWeights, DependOnlyOnTheSeed) {
  const AgentSpec spec = *FindAgent("ppo_cnn");
  const std::vector<float> weights = InitialWeights(spec, 1);
  EXPECT_EQ(InitialWeights(spec, 1), weights);
  for (const int threads : {1, 2, 3}) {
    WorkerPool workers(threads, [] {});
    EXPECT_EQ(InitialWeights(spec, 1, &workers), weights) << threads << " threads";
  }
  EXPECT_NE(InitialWeights(spec, 2), weights);
}

// Least, greatest and mean square of the parameter `name`.
struct Range {
  float least = 0;
  float greatest = 0;
  double mean_square = 0;
};

Range RangeOf(const std::string& agent, const std::string& name) {
  const AgentSpec spec = *FindAgent(agent);
  static auto* const known = new std::map<std::string, std::vector<float>>;
  std::vector<float>& weights = (*known)[agent];
  if (weights.empty()) weights = InitialWeights(spec, 4);
  Range range;
  for (const ParamSpec& param : spec.params) {
    if (param.name != name) continue;
    for (int64_t i = param.offset; i < param.offset + param.size; ++i) {
      range.least = std::min(range.least, weights[i]);
      range.greatest = std::max(range.greatest, weights[i]);
      range.mean_square += double{weights[i]} * weights[i] / static_cast<double>(param.size);
    }
  }
  return range;
}

// Source: AGENTS.md, section 9.
TEST(InitialWeights, LstmAndItsCriticAreUniform) {
  for (const char* const name : {"lstm_actor.weight_ih_l0", "lstm_actor.weight_hh_l0", "lstm_actor.bias_ih_l0"}) {
    const Range range = RangeOf("lstm_cnn", name);
    EXPECT_GE(range.least, -1.0F / 16) << name;
    EXPECT_LE(range.greatest, 1.0F / 16) << name;
    EXPECT_NEAR(range.mean_square, 1.0 / 256 / 3, 1e-4) << name;
  }
  const double bound = 1 / std::sqrt(512.0);
  const Range critic = RangeOf("lstm_cnn", "critic.weight");
  EXPECT_LE(critic.greatest, bound);
  EXPECT_GT(critic.greatest, 0.99 * bound);
  EXPECT_LT(critic.least, -0.99 * bound);
  EXPECT_GT(RangeOf("lstm_cnn", "critic.bias").greatest, 0.9 * bound);
}

TEST(InitialWeights, SlotsAndClsAreStandardNormal) {
  EXPECT_NEAR(RangeOf("oc_ca", "features_extractor.rsn.slots").mean_square, 1, 5 * std::sqrt(2.0 / 2048));
  EXPECT_NEAR(RangeOf("oc_sa", "features_extractor.rsn.trafo.cls").mean_square, 1, 5 * std::sqrt(2.0 / 9216));
}

TEST(InitialWeights, AreNormalBeforeOrthogonalisation) {
  // One long row keeps the shape of its numbers: mean 0, variance 1/n, fourth moment 3/n^2.
  const int64_t n = 100000;
  const std::vector<float> weights = InitialWeights(OneLayer(1, n, 1.0), 5);
  double mean = 0;
  double fourth = 0;
  for (int64_t i = 0; i < n; ++i) {
    const double x = weights[i] * std::sqrt(static_cast<double>(n));
    mean += x / n;
    fourth += x * x * x * x / n;
  }
  EXPECT_NEAR(mean, 0, 4 / std::sqrt(static_cast<double>(n)));
  EXPECT_NEAR(fourth, 3, 4 * std::sqrt(96.0 / n));  // its variance is 96/n
}

}  // namespace
}  // namespace craftfleet
