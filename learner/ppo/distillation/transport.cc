#include "learner/ppo/distillation/transport.h"

#include <algorithm>
#include <cmath>
#include <numeric>

namespace craftfleet {
namespace {

// Hardly more than the least number of double, with room for corrections. Of 0 there would be none.
constexpr double kLeastMass = 1e-304;
constexpr double kMostExponent = 700;  // exp of its negative is about as much

double Sum(const std::vector<double>& values) {
  double sum = 0;
  for (const double x : values) sum += x;
  return sum;
}

// Rows or columns of a plan: `count` lines of `length` numbers.
struct Lines {
  int count;
  int length;
  int step;  // from one line to the next
  int next;  // from one number of a line to the next
};

// Projects onto the plans whose lines sum up to at most 1. `corrections`, one for each line, undo the last projection.
void BoundLines(const Lines& lines, std::vector<double>* corrections, std::vector<double>* plan) {
  for (int i = 0; i < lines.count; ++i) {
    double* const line = plan->data() + i * lines.step;
    double& correction = (*corrections)[i];
    double sum = 0;
    for (int k = 0; k < lines.length; ++k) sum += line[k * lines.next] *= correction;
    const double factor = std::min(1.0, 1 / sum);
    for (int k = 0; k < lines.length; ++k) line[k * lines.next] *= factor;
    correction = 1 / factor;
  }
}

}  // namespace

std::vector<double> TransportPlan(absl::Span<const float> cost, int rows, int columns,
                                  const TransportOptions& options) {
  const double mass = std::min(rows, columns);
  std::vector<double> plan(cost.size());
  // Only differences of costs count: the shift keeps all numbers from becoming 0.
  const double least = *std::min_element(cost.begin(), cost.end());
  const double shift = least / options.regularization > kMostExponent ? least : 0;
  for (size_t i = 0; i < cost.size(); ++i) {
    plan[i] = std::max(std::exp((shift - cost[i]) / options.regularization), kLeastMass);
  }
  const double scale = mass / Sum(plan);
  for (double& x : plan) x *= scale;

  std::vector<double> row_corrections(rows, 1.0);
  std::vector<double> column_corrections(columns, 1.0);
  double total_correction = 1;
  std::vector<double> last;
  for (int round = 0; round < options.rounds; ++round) {
    last = plan;
    BoundLines({rows, columns, columns, 1}, &row_corrections, &plan);
    BoundLines({columns, rows, 1, columns}, &column_corrections, &plan);
    for (double& x : plan) x *= total_correction;
    const double factor = mass / Sum(plan);
    if (!std::isfinite(factor) || factor == 0) return last;  // corrections have outgrown double
    for (double& x : plan) x *= factor;
    total_correction = 1 / factor;
  }
  return plan;
}

std::vector<Match> MatchesOf(absl::Span<const double> plan, int columns, double threshold) {
  std::vector<Match> matches;
  for (int i = 0; i < static_cast<int>(plan.size()); ++i) {
    if (static_cast<float>(plan[i]) > threshold) matches.push_back({i / columns, i % columns});
  }
  return matches;
}

std::vector<Match> MatchGoals(absl::Span<const float> source, absl::Span<const float> target, size_t size,
                              const TransportOptions& options, double threshold) {
  std::vector<float> cost;
  for (size_t i = 0; i < source.size(); i += size) {
    for (size_t j = 0; j < target.size(); j += size) {
      cost.push_back(1 - std::inner_product(&source[i], &source[i] + size, &target[j], 0.0F));
    }
  }
  const auto rows = static_cast<int>(source.size() / size);
  const auto columns = static_cast<int>(target.size() / size);
  std::vector<Match> matches = MatchesOf(TransportPlan(cost, rows, columns, options), columns, threshold);
  const auto is_zero = [&](const Match& match) {
    const absl::Span<const float> change = source.subspan(match.row * size, size);
    return std::all_of(change.begin(), change.end(), [](float x) { return x == 0; });
  };
  matches.erase(std::remove_if(matches.begin(), matches.end(), is_zero), matches.end());
  return matches;
}

}  // namespace craftfleet
