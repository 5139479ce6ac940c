// Runs of one configuration with different seeds, and their averages.

#ifndef CRAFTFLEET_DEPLOY_CLI_REPORT_RUN_GROUP_H_
#define CRAFTFLEET_DEPLOY_CLI_REPORT_RUN_GROUP_H_

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include <absl/functional/function_ref.h>
#include <absl/types/span.h>

#include "deploy/cli/report/run_record.h"

namespace craftfleet {

// Mean and sample standard deviation (n - 1) of one number per seed.
struct Spread {
  int n = 0;
  double mean = 0;                  // undefined if n is 0
  std::optional<double> deviation;  // with two seeds or more
};

Spread SpreadOf(absl::Span<const double> values);

// "10.3 +- 0.6" with `sign` for "+-"; "10.3" with one seed, "-" with none. One decimal.
std::string FormatSpread(const Spread& spread, absl::string_view sign);

struct RunGroup {
  std::vector<const RunRecord*> complete;    // by seed, each once
  std::vector<const RunRecord*> incomplete;  // not averaged
  std::vector<const RunRecord*> repeated;    // further runs of the same seed; not counted

  // Spread of `value` over the complete runs that have it.
  Spread Over(absl::FunctionRef<std::optional<double>(const RunRecord&)> value) const;
  // Success rate of achievement 0..21 in training episodes of the complete runs, percent.
  Spread SuccessOf(int achievement) const;
  // Score of the training episodes that had ended by `steps`, over all runs that have reached it, incomplete ones too.
  Spread ScoresAt(int64_t steps) const;
};

// By identity. The pointers are to elements of `runs`.
std::map<std::string, RunGroup> GroupRuns(absl::Span<const RunRecord> runs);

// A number that the report shows of each run.
struct Measure {
  absl::string_view name;                                // in CSV files
  absl::string_view label;                               // in tables
  std::optional<double> (*value)(const RunRecord& run);  // nullopt: the run has no such episodes
};

// The score of training episodes first, then those of evaluations, rewards and achievements.
absl::Span<const Measure> Measures();
// The measure of that name, which exists.
const Measure& MeasureNamed(absl::string_view name);

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_CLI_REPORT_RUN_GROUP_H_
