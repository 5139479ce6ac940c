#include "common/agent/initial_weights.h"

#include <cmath>

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

TEST(InitialWeights, AreOrthogonalTimesTheirGainAndBiasesAreZero) {
  for (const AgentSpec& spec : {*FindAgent("ppo_cnn"), OneLayer(5, 5, 2.0), OneLayer(1, 9, 1.0)}) {
    const std::vector<float> weights = InitialWeights(spec, 3);
    for (const ParamSpec& param : spec.params) {
      const float* weight = &weights[param.offset];
      if (param.init.kind == ParamInit::Kind::kConstant) {
        for (int64_t i = 0; i < param.size; ++i) ASSERT_EQ(weight[i], 0) << param.name;
        continue;
      }
      const int64_t rows = param.shape[0];
      const int64_t columns = param.size / rows;
      for (int64_t a = 0; a < rows; a += 7) {
        for (int64_t b = 0; b <= a; b += 7) {
          double dot = 0;
          for (int64_t k = 0; k < columns; ++k) dot += double{weight[a * columns + k]} * weight[b * columns + k];
          EXPECT_NEAR(dot / (param.init.scale * param.init.scale), a == b ? 1 : 0, 1e-6)
              << param.name << " " << a << " " << b;
        }
      }
    }
  }
}

TEST(InitialWeights, TallMatricesHaveOrthonormalColumns) {
  const AgentSpec spec = OneLayer(9, 3, 1.0);
  const std::vector<float> weights = InitialWeights(spec, 3);
  for (int a = 0; a < 3; ++a) {
    for (int b = 0; b < 3; ++b) {
      double dot = 0;
      for (int row = 0; row < 9; ++row) dot += double{weights[row * 3 + a]} * weights[row * 3 + b];
      EXPECT_NEAR(dot, a == b ? 1 : 0, 1e-6);
    }
  }
}

TEST(InitialWeights, FollowFromTheSeedAlone) {
  const AgentSpec spec = *FindAgent("ppo_cnn");
  EXPECT_EQ(InitialWeights(spec, 1), InitialWeights(spec, 1));
  EXPECT_NE(InitialWeights(spec, 1), InitialWeights(spec, 2));
}

TEST(InitialWeights, LookNormalBeforeTheyAreOrthogonal) {
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
