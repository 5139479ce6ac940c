#include "learner/ppo/distillation/distillation_loss.h"

#include <cmath>
#include <tuple>
#include <vector>

#include <gtest/gtest.h>

#include "common/agent/code_change.h"
#include "common/base/crafter.h"
#include "learner/ppo/value_norm.h"
#include "tests/agent/golden_agent.h"

namespace craftfleet {
namespace distillation_loss_test {

using Rows = std::vector<std::vector<float>>;

nlohmann::json Golden(const char* part) { return ReadGolden("achievement_distillation.json")[part]; }

void ExpectRows(const Rows& actual, const nlohmann::json& expected) {
  ASSERT_EQ(actual.size(), expected.size());
  for (size_t row = 0; row < actual.size(); ++row) {
    for (size_t i = 0; i < actual[row].size(); ++i) {
      EXPECT_NEAR(actual[row][i], expected[row][i].get<double>(), 1e-7) << row << " " << i;
    }
  }
}

// The vectors of the golden, and gradients like them.
struct Example {
  Rows anchor, positive, negative;
  Rows by_anchor, by_positive, by_negative;
};

Example ExampleOf(const nlohmann::json& golden) {
  Example example;
  for (const auto& [name, rows, gradients] : {std::tuple("anchor", &example.anchor, &example.by_anchor),
                                              std::tuple("positive", &example.positive, &example.by_positive),
                                              std::tuple("negative", &example.negative, &example.by_negative)}) {
    *rows = golden[name].get<Rows>();
    *gradients = Rows(rows->size(), std::vector<float>((*rows)[0].size()));
  }
  return example;
}

TEST(ContrastiveLoss, PredictionsLossAndGradientsMatchTheGolden) {
  const nlohmann::json golden = Golden("contrastive");
  Example example = ExampleOf(golden);
  std::vector<ContrastiveRow> rows;
  for (size_t i = 0; i < example.anchor.size(); ++i) {
    rows.push_back({example.anchor[i].data(), example.positive[i].data(), example.negative[i].data(), nullptr,
                    example.by_positive[i].data(), example.by_negative[i].data()});
  }
  const double loss = ContrastiveLoss(rows, 4, golden["temperature"]);
  EXPECT_NEAR(loss, golden["loss"].get<double>(), 1e-9);
  ExpectRows(example.by_positive, golden["prediction_gradient"]["by_positive"]);
  ExpectRows(example.by_negative, golden["prediction_gradient"]["by_negative"]);
  EXPECT_NEAR(ContrastiveLoss({rows[3]}, 4, golden["temperature"]), std::log(2), 1e-9) << "an anchor of zero";
}

TEST(ContrastiveLoss, MatchingsGradientMatchesTheGolden) {
  const nlohmann::json golden = Golden("contrastive");
  const nlohmann::json& gradient = golden["matching_gradient"];
  Example example = ExampleOf(golden);
  std::vector<ContrastiveRow> rows;
  Rows by_anchor;
  for (size_t i = 0; i < example.anchor.size(); ++i) {
    rows.push_back({example.anchor[i].data(), example.positive[i].data(), example.negative[i].data(),
                    example.by_anchor[i].data(), nullptr, nullptr});
  }
  ContrastiveLoss(rows, 4, golden["temperature"]);
  EXPECT_EQ(example.by_anchor[3], std::vector<float>(4)) << "an anchor of zero has no direction to learn";
  for (const size_t i : gradient["rows"].get<std::vector<size_t>>()) by_anchor.push_back(example.by_anchor[i]);
  ExpectRows(by_anchor, gradient["by_anchor"]);
}

TEST(ContrastiveLoss, GradientsAreAddedToWhatIsThere) {
  const std::vector<float> x = {1, 0};
  const std::vector<float> y = {0, 1};
  std::vector<float> gradient = {0, 0};
  const ContrastiveRow row = {x.data(), y.data(), x.data(), nullptr, gradient.data(), nullptr};
  ContrastiveLoss({row}, 2, 1);
  const float once = gradient[0];
  EXPECT_LT(once, 0);
  ContrastiveLoss({row}, 2, 1);
  EXPECT_FLOAT_EQ(gradient[0], 2 * once);
}

// The golden's logits as those of 17 actions: the others are impossible.
std::vector<float> Padded(const nlohmann::json& logits) {
  std::vector<float> padded(kNumActions, -1e4F);
  for (size_t i = 0; i < logits.size(); ++i) padded[i] = logits[i];
  return padded;
}

TEST(PolicyDivergence, MatchesTheGolden) {
  const nlohmann::json golden = Golden("keep");
  for (size_t row = 0; row < golden["new_logits"].size(); ++row) {
    std::vector<float> gradient(kNumActions);
    EXPECT_NEAR(PolicyDivergence(Padded(golden["new_logits"][row]).data(), Padded(golden["old_logits"][row]).data(), 1,
                                 gradient.data()),
                golden["kl_new_old_rows"][row].get<double>(), 1e-9);
  }
}

TEST(PolicyDivergence, GradientIsThatOfFiniteDifferences) {
  const std::vector<float> logits = GoldenUniforms("new", kNumActions, -1, 1);
  const std::vector<float> old = GoldenUniforms("old", kNumActions, -1, 1);
  std::vector<float> gradient(kNumActions);
  std::vector<float> unused(kNumActions);
  PolicyDivergence(logits.data(), old.data(), 3, gradient.data());
  for (int i = 0; i < kNumActions; ++i) {
    std::vector<float> up = logits;
    std::vector<float> down = logits;
    up[i] += 1e-3F;
    down[i] -= 1e-3F;
    const double slope = (PolicyDivergence(up.data(), old.data(), 1, unused.data()) -
                          PolicyDivergence(down.data(), old.data(), 1, unused.data())) /
                         (double{up[i]} - down[i]);
    EXPECT_NEAR(gradient[i], 3 * slope, 1e-5) << i;
  }
}

TEST(NormalisedValueLoss, MatchesTheGoldenOfDistillation) {
  const nlohmann::json golden = Golden("value_normaliser");
  ValueNorm norm;
  EXPECT_NEAR(norm.Scale(0.1).Denormalise(1.5F), golden["before_any"]["denormalised_of_1_5"].get<double>(), 1e-6);
  for (const nlohmann::json& step : golden["steps"]) {
    norm.Update(step["input"].get<std::vector<float>>(), golden["decay"]);
    EXPECT_NEAR(norm.mean, step["a"].get<double>(), 1e-9);
    EXPECT_NEAR(norm.mean_square, step["q"].get<double>(), 1e-9);
    EXPECT_NEAR(norm.weight, step["w"].get<double>(), 1e-9);
    EXPECT_NEAR(norm.Scale().mean, step["mean"].get<double>(), 1e-9);
    EXPECT_NEAR(norm.Scale().deviation, step["deviation"].get<double>(), 1e-9);
  }
}

// A memory is replaced by the change of features where a step unlocked something, and is zero where an episode begins.
TEST(CodeChange, MemoriesMatchTheGolden) {
  const nlohmann::json golden = Golden("memory");
  std::vector<float> memory(4);
  for (size_t t = 0; t < golden["unlocked"].size(); ++t) {
    for (size_t i = 0; i < memory.size(); ++i) {
      EXPECT_NEAR(memory[i], golden["memory"][t][i].get<double>(), 1e-7) << t;
    }
    const auto before = golden["code_acted_on"][t].get<std::vector<float>>();
    const auto after = golden["code_led_to"][t].get<std::vector<float>>();
    if (golden["unlocked"][t] == 1) CodeChange(before, after, absl::MakeSpan(memory));
    if (golden["done"][t] == 1) std::fill(memory.begin(), memory.end(), 0.0F);
  }
}

}  // namespace distillation_loss_test
}  // namespace craftfleet
