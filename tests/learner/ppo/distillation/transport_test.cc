#include "learner/ppo/distillation/transport.h"

#include <numeric>
#include <vector>

#include <gtest/gtest.h>

#include "tests/agent/golden_agent.h"

namespace craftfleet {
namespace {

void ExpectPlan(const std::vector<double>& plan, const nlohmann::json& expected, double tolerance) {
  const size_t columns = expected[0].size();
  ASSERT_EQ(plan.size(), expected.size() * columns);
  for (size_t i = 0; i < plan.size(); ++i) {
    EXPECT_NEAR(plan[i], expected[i / columns][i % columns].get<double>(), tolerance) << i;
  }
}

TEST(Transport, PlansAndMatchesMatchTheGolden) {
  const nlohmann::json golden = ReadGolden("achievement_distillation.json")["transport"];
  ASSERT_GE(golden["cases"].size(), 7U);
  for (const nlohmann::json& example : golden["cases"]) {
    SCOPED_TRACE(example["name"].get<std::string>());
    const int rows = static_cast<int>(example["cost"].size());
    const int columns = static_cast<int>(example["cost"][0].size());
    std::vector<float> cost;
    for (const nlohmann::json& row : example["cost"]) cost.insert(cost.end(), row.begin(), row.end());
    const auto plan = [&](int rounds) { return TransportPlan(cost, rows, columns, {golden["epsilon"], rounds}); };
    ExpectPlan(plan(1), example["after_1"], 1e-9);
    ExpectPlan(plan(10), example["after_10"], 1e-9);
    ExpectPlan(plan(golden["iterations"]), example["plan"], 1e-9);
    std::vector<Match> matches;
    for (const nlohmann::json& match : example["matches"]) matches.push_back({match[0], match[1]});
    EXPECT_EQ(MatchesOf(plan(golden["iterations"]), columns, 0.5), matches);
  }
}

// exp(-cost / regularization) is 0 for each of them.
TEST(Transport, APlanOfHighCostsHasAllMass) {
  EXPECT_EQ(TransportPlan({0.9F}, 1, 1, {1e-3, 100}), std::vector<double>{1});
  const std::vector<double> plan = TransportPlan({0.9F, 0.91F, 0.91F, 0.9F}, 2, 2, {1e-3, 100});
  EXPECT_EQ(MatchesOf(plan, 2, 0.5), (std::vector<Match>{{0, 0}, {1, 1}}));
}

// The first goal is so near that the other numbers begin as 0, while its own correction grows from round to round.
TEST(Transport, APlanOfVeryDifferentCostsConverges) {
  const std::vector<double> plan = TransportPlan({0.1F, 0.95F, 0.9F, 0.9F}, 2, 2, {1e-3, 10'000});
  ExpectPlan(plan, {{1, 0}, {0, 1}}, 1e-3);
}

// Corrections grow from round to round until they are infinite. The plan was NaN then.
TEST(Transport, APlanOfManyRoundsIsFiniteAndHasAllMass) {
  const std::vector<double> plan = TransportPlan({2, 2, 2, 0, 2, 2, 2, 2, 0, 2, 2, 2, 2, 2, 2}, 3, 5, {1e-3, 5000});
  EXPECT_NEAR(std::accumulate(plan.begin(), plan.end(), 0.0), 3, 1e-9);
}

TEST(Transport, AMatchHasMoreThanTheThreshold) {
  EXPECT_EQ(MatchesOf({0.5, 0.6, 0.2, 0.5}, 2, 0.5), (std::vector<Match>{{0, 1}}));
}

// Three directions; a target that has them in another order, and one more.
TEST(MatchGoals, FindsTheSameChangesInAnotherOrder) {
  const std::vector<float> source = {1, 0, 0, 0, 1, 0};
  const std::vector<float> target = {0, 0, 1, 0.8F, 0.6F, 0, 0, 1, 0};
  EXPECT_EQ(MatchGoals(source, target, 3, {}, 0.5), (std::vector<Match>{{0, 1}, {1, 2}}));
  EXPECT_EQ(MatchGoals(target, source, 3, {}, 0.5), (std::vector<Match>{{1, 0}, {2, 1}}));
}

TEST(MatchGoals, NeedMoreThanTheThreshold) {
  const std::vector<float> one = {1, 0};
  const std::vector<float> twice = {1, 0, 1, 0};
  EXPECT_EQ(MatchGoals(one, twice, 2, {}, 0.5), std::vector<Match>()) << "half to each";
  EXPECT_EQ(MatchGoals(one, twice, 2, {}, 0.4), (std::vector<Match>{{0, 0}, {0, 1}}));
}

TEST(MatchGoals, ASourceWithoutAChangeHasNoMatch) {
  const std::vector<float> source = {0, 0, 0, 1};
  const std::vector<float> target = {1, 0, 0, 1};
  EXPECT_EQ(MatchGoals(source, target, 2, {}, 0.5), (std::vector<Match>{{1, 1}}));
  EXPECT_EQ(MatchGoals(target, source, 2, {}, 0.5), (std::vector<Match>{{0, 0}, {1, 1}})) << "a target may have none";
}

}  // namespace
}  // namespace craftfleet
