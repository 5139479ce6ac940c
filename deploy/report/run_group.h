// Runs of one configuration with different seeds, and what they give together.

#ifndef CRAFTFLEET_DEPLOY_REPORT_RUN_GROUP_H_
#define CRAFTFLEET_DEPLOY_REPORT_RUN_GROUP_H_

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include <absl/functional/function_ref.h>
#include <absl/types/span.h>

#include "deploy/report/run_record.h"

namespace craftfleet {

// Mean and sample standard deviation (n - 1) of one number per seed.
struct Spread {
  int n = 0;
  double mean = 0;                  // of no use without any
  std::optional<double> deviation;  // from two seeds on
};

Spread SpreadOf(absl::Span<const double> values);

// "10.3 +- 0.6" with `sign` for "+-"; "10.3" with one seed, "-" without any. One decimal.
std::string FormatSpread(const Spread& spread, absl::string_view sign);

struct RunGroup {
  std::vector<const RunRecord*> complete;    // by seed, each once
  std::vector<const RunRecord*> incomplete;  // not averaged
  std::vector<const RunRecord*> repeated;    // of a seed that is there already; not counted

  // Of `value` over the complete runs that have one.
  Spread Over(absl::FunctionRef<std::optional<double>(const RunRecord&)> value) const;
  // Success rate of achievement 0..21 in training episodes of the complete runs, percent.
  Spread SuccessOf(int achievement) const;
  // Score of the training episodes that had ended by `steps`, of every run that has got so far, incomplete ones too.
  Spread ScoresAt(int64_t steps) const;
};

// By identity; the pointers are to `runs`.
std::map<std::string, RunGroup> GroupRuns(absl::Span<const RunRecord> runs);

// What is measured of a run.
struct Measure {
  absl::string_view name;                                // in CSV files
  absl::string_view label;                               // in tables
  std::optional<double> (*value)(const RunRecord& run);  // nullopt: the run has no such episodes
};

// Score of training episodes first; then of evaluation episodes, rewards, achievements.
absl::Span<const Measure> Measures();
// One of them, by its name.
const Measure& MeasureNamed(absl::string_view name);

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_REPORT_RUN_GROUP_H_
