#include "learner/ppo/adam.h"

#include <cmath>

#include <gtest/gtest.h>

#include "common/base/keyed_random.h"

namespace craftfleet {
namespace {

constexpr size_t kPieces[] = {1, 40000, 7, 16384};  // one longer than a block, one as long

// A gradient in pieces, with the memory under it.
struct Gradient {
  std::vector<float> values;
  ShardGradient pieces;

  explicit Gradient(int seed, float scale) {
    size_t size = 0;
    for (const size_t piece : kPieces) size += piece;
    for (size_t i = 0; i < size; ++i) {
      values.push_back(scale * (static_cast<float>(ActionNoise(seed, 0, static_cast<int64_t>(i))) - 0.4F));
    }
    size_t offset = 0;
    for (const size_t piece : kPieces) {
      pieces.push_back(absl::MakeSpan(values).subspan(offset, piece));
      offset += piece;
    }
  }
};

AdamState FreshState(size_t size) { return {0, std::vector<float>(size), std::vector<float>(size)}; }

TEST(Adam, FollowsThePublishedFormulas) {
  AdamOptions options;
  options.max_gradient_norm = 1e9;
  WorkerPool workers(1, [] {});
  const size_t size = Gradient(1, 1).values.size();
  std::vector<float> weights(size, 1.0F);
  AdamState state = FreshState(size);
  std::vector<double> expected(size, 1.0);
  std::vector<double> m(size);
  std::vector<double> v(size);
  for (int t = 1; t <= 5; ++t) {
    Gradient first(t, 1);
    Gradient second(100 + t, 1);
    double squares = 0;
    for (size_t i = 0; i < size; ++i) {
      const double g = first.values[i] + second.values[i];
      squares += g * g;
      m[i] = 0.9 * m[i] + 0.1 * g;
      v[i] = 0.999 * v[i] + 0.001 * g * g;
      expected[i] -= 3e-4 * (m[i] / (1 - std::pow(0.9, t))) / (std::sqrt(v[i] / (1 - std::pow(0.999, t))) + 1e-5);
    }
    const std::vector<ShardGradient> shards = {first.pieces, second.pieces};
    EXPECT_NEAR(AdamStep(options, shards, absl::MakeSpan(weights), &state, &workers), std::sqrt(squares), 1e-4);
    EXPECT_EQ(state.steps, t);
  }
  for (size_t i = 0; i < size; ++i) ASSERT_NEAR(weights[i], expected[i], 1e-6) << i;
}

TEST(Adam, ClipsByTheGlobalNorm) {
  WorkerPool workers(1, [] {});
  AdamOptions options;
  for (const float scale : {100.0F, 1e-6F}) {
    Gradient gradient(1, scale);
    const size_t size = gradient.values.size();
    std::vector<float> weights(size);
    AdamState state = FreshState(size);
    const std::vector<ShardGradient> shards = {gradient.pieces};
    const double norm = AdamStep(options, shards, absl::MakeSpan(weights), &state, &workers);
    const double clip = norm > 0.5 ? 0.5 / norm : 1;
    for (size_t i = 0; i < size; i += 777) {
      EXPECT_NEAR(state.exp_avg[i], 0.1 * gradient.values[i] * clip, 1e-4 * std::abs(state.exp_avg[i]) + 1e-12);
    }
  }
}

}  // namespace
}  // namespace craftfleet
