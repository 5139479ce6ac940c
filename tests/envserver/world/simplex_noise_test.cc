#include "envserver/world/simplex_noise.h"

#include <cmath>
#include <cstdint>
#include <vector>

#include <gtest/gtest.h>

namespace craftfleet {
namespace {

double At(const SimplexNoise& noise, double x, double y, double z) {
  double value = 0;
  NoisePlane(noise, {x, x, y, y}, z)
      .Evaluate(absl::MakeConstSpan(&x, 1), absl::MakeConstSpan(&y, 1), absl::MakeSpan(&value, 1));
  return value;
}

// Values of the plain Python model, which agrees with the opensimplex package on 60,000 points.
TEST(SimplexNoise, MatchesOpenSimplexBitForBit) {
  struct Value {
    int64_t seed;
    double x, y, z, noise;
  };
  constexpr Value kValues[] = {
      {0, -10.403586676153658, 32.705472014825986, 4.0, -0.4603463364057158},
      {0, 39.65158684083703, 8.571428571428571, 3.0, 0.24481136007927917},
      {0, 2.7142857142857144, 6.666666666666667, 4.0, -0.27031291504844696},
      {0, 17.1303586888962, 7.142857142857143, 5.0, 0.036051088709814404},
      {0, 4.0, 22.317806855826547, 6.0, 0.3836077783587128},
      {0, 2.728246799155528, 1.9333333333333333, 4.0, -0.1953077427332843},
      {0, 1.3333333333333333, 1.8, 7.0, -0.46780911897581295},
      {0, 20.333333333333332, -38.38997167712972, 6.0, -0.49528059082041975},
      {12345, 5.0, 4.068115282598313, 8.0, 0.04918752573820555},
      {12345, 10.0, 35.911639450421845, 4.0, 0.013795383794354901},
      {12345, 15.17864587452162, 36.6927541126764, 6.0, 0.5009552703374286},
      {12345, 8.285714285714286, 4.857142857142857, 4.0, -0.44373602212420915},
      {12345, 1.6901834624964778, 38.99647449252916, 0.0, 0.23989740379838467},
      {12345, -35.19355914978216, 14.34251184304869, 4.0, -0.235645592102972},
      {12345, 20.666666666666668, 10.237547431178164, 5.0, -0.05413659069193834},
      {12345, -25.18031638105473, 2.2, 0.0, -0.12657018108877127},
      {2147483645, 0.0008572474347516845, -25.008452726564645, 1.0, 0.014974032696021985},
      {2147483645, 0.8666666666666667, 11.2, 7.0, 0.24900179894701888},
      {2147483645, 6.8, 1.6, 4.0, 0.19721726956730212},
      {2147483645, 24.500627290804402, -16.64456873035573, 7.0, 0.6332929751020386},
      {2147483645, -16.768099415438662, 0.5714285714285714, 7.0, -0.4599513855629876},
      {2147483645, -37.41454795269787, 2.4, 4.0, 0.43382945427512937},
      {2147483645, 3.0, 18.333333333333332, 2.0, 0.3958035838920688},
      {2147483645, 13.031688344386254, -12.691787406560387, 8.0, -0.2254683158877567},
  };
  for (const Value& value : kValues) {
    EXPECT_EQ(At(SimplexNoise(value.seed), value.x, value.y, value.z), value.noise)
        << value.seed << " at " << value.x << " " << value.y << " " << value.z;
  }
}

// Many points at a time use vector instructions, with an odd remainder.
TEST(SimplexNoise, EvaluatingManyPointsEqualsOneByOne) {
  const SimplexNoise noise(77);
  std::vector<double> x;
  std::vector<double> y;
  for (int i = 0; i < 1001; ++i) {
    x.push_back(std::fmod(i * 0.37, 11.0) - 3);
    y.push_back(std::fmod(i * 0.61, 13.0) - 5);
  }
  std::vector<double> all(x.size());
  NoisePlane(noise, {-3, 8, -5, 8}, 3).Evaluate(x, y, absl::MakeSpan(all));
  for (size_t i = 0; i < x.size(); ++i) EXPECT_EQ(all[i], At(noise, x[i], y[i], 3)) << i;
}

}  // namespace
}  // namespace craftfleet
