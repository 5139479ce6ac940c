// Optimal transport between the achievements of two episodes: which of them are the same. No LibTorch.

#pragma once

#include <cstddef>
#include <vector>

#include <absl/types/span.h>

namespace craftfleet {

struct TransportOptions {
  double regularization = 0.05;  // weight of the plan's entropy
  int rounds = 100;              // of the three projections
};

// The plan T[rows,columns] >= 0 that moves a mass of min(rows, columns) for the least `cost`[rows,columns], with at
// most 1 from each row and to each column. It minimises sum T * cost + regularization * sum T * ln T, by Dykstra's
// scheme. Source: Benamou et al. 2015; DISTILLATION.md, section 4.
std::vector<double> TransportPlan(absl::Span<const float> cost, int rows, int columns, const TransportOptions& options);

struct Match {
  int row = 0;
  int column = 0;
  friend bool operator==(const Match& a, const Match& b) { return a.row == b.row && a.column == b.column; }
};

// Where the plan, in float32, is more than `threshold`; row by row.
std::vector<Match> MatchesOf(absl::Span<const double> plan, int columns, double threshold);

// The achievements of two episodes that are the same, by their changes of features, float[rows,size] and
// float[columns,size], each of length 1 or 0: the matches of the plan whose cost is 1 - cosine. A row of zeros, which
// has no direction to learn, has none.
std::vector<Match> MatchGoals(absl::Span<const float> source, absl::Span<const float> target, size_t size,
                              const TransportOptions& options, double threshold);

}  // namespace craftfleet
