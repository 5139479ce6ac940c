#include "deploy/cli/report/run_group.h"

#include <algorithm>
#include <array>
#include <cmath>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>

#include "common/base/check.h"

namespace craftfleet {
namespace {

std::optional<double> IfAny(const Performance& performance, double value) {
  if (performance.episodes == 0) return std::nullopt;
  return value;
}

using Run = const RunRecord&;
constexpr std::array<Measure, 9> kMeasures = {{
    {"train", "training score", [](Run run) { return IfAny(run.training, run.training.score); }},
    {"eval", "evaluation score", [](Run run) { return IfAny(run.eval_sampled, run.eval_sampled.score); }},
    {"eval_argmax", "evaluation score, argmax", [](Run run) { return IfAny(run.eval_argmax, run.eval_argmax.score); }},
    {"final", "final score", [](Run run) { return IfAny(run.final_sampled, run.final_sampled.score); }},
    {"final_argmax", "final score, argmax", [](Run run) { return IfAny(run.final_argmax, run.final_argmax.score); }},
    {"reward", "reward", [](Run run) { return IfAny(run.training, run.training.reward); }},
    {"reward_last100", "reward, last 100", [](Run run) { return IfAny(run.training, run.training.recent_reward); }},
    {"unlocked", "achievements unlocked", [](Run run) { return IfAny(run.training, run.training.unlocked); }},
    {"episodes", "episodes", [](Run run) { return IfAny(run.training, static_cast<double>(run.training.episodes)); }},
}};

// nullopt if the run has not reached `steps`, or no episode had ended by then.
std::optional<double> ScoreAt(const RunRecord& run, int64_t steps) {
  if (run.steps < steps) return std::nullopt;
  const auto after = std::upper_bound(run.curve.begin(), run.curve.end(), steps,
                                      [](int64_t value, const CurvePoint& point) { return value < point.steps; });
  if (after == run.curve.begin()) return std::nullopt;
  return std::prev(after)->score;
}

}  // namespace

Spread SpreadOf(absl::Span<const double> values) {
  Spread spread;
  spread.n = static_cast<int>(values.size());
  if (spread.n == 0) return spread;
  for (const double value : values) spread.mean += value / spread.n;
  if (spread.n == 1) return spread;
  double squares = 0;
  for (const double value : values) squares += (value - spread.mean) * (value - spread.mean);
  spread.deviation = std::sqrt(squares / (spread.n - 1));
  return spread;
}

std::string FormatSpread(const Spread& spread, absl::string_view sign) {
  if (spread.n == 0) return "-";
  if (!spread.deviation.has_value()) return absl::StrFormat("%.1f", spread.mean);
  return absl::StrFormat("%.1f %s %.1f", spread.mean, sign, *spread.deviation);
}

Spread RunGroup::Over(absl::FunctionRef<std::optional<double>(const RunRecord&)> value) const {
  std::vector<double> values;
  for (const RunRecord* run : complete) {
    if (const std::optional<double> of_run = value(*run); of_run.has_value()) values.push_back(*of_run);
  }
  return SpreadOf(values);
}

Spread RunGroup::SuccessOf(int achievement) const {
  return Over([achievement](const RunRecord& run) { return IfAny(run.training, run.training.success[achievement]); });
}

Spread RunGroup::ScoresAt(int64_t steps) const {
  std::vector<double> scores;
  for (const auto* runs : {&complete, &incomplete}) {
    for (const RunRecord* run : *runs) {
      if (const std::optional<double> score = ScoreAt(*run, steps); score.has_value()) scores.push_back(*score);
    }
  }
  return SpreadOf(scores);
}

std::map<std::string, RunGroup> GroupRuns(absl::Span<const RunRecord> runs) {
  std::map<std::string, RunGroup> groups;
  for (const bool complete : {true, false}) {
    for (const RunRecord& run : runs) {
      if (run.complete != complete) continue;
      RunGroup& group = groups[run.identity];
      const auto same_seed = [&run](const RunRecord* other) { return other->config.seed() == run.config.seed(); };
      const bool repeated = std::any_of(group.complete.begin(), group.complete.end(), same_seed) ||
                            std::any_of(group.incomplete.begin(), group.incomplete.end(), same_seed);
      (repeated ? group.repeated : complete ? group.complete : group.incomplete).push_back(&run);
    }
  }
  const auto by_seed = [](const RunRecord* a, const RunRecord* b) { return a->config.seed() < b->config.seed(); };
  for (auto& [identity, group] : groups) {
    std::sort(group.complete.begin(), group.complete.end(), by_seed);
    std::sort(group.incomplete.begin(), group.incomplete.end(), by_seed);
  }
  return groups;
}

absl::Span<const Measure> Measures() { return kMeasures; }

const Measure& MeasureNamed(absl::string_view name) {
  const auto* const found =
      std::find_if(kMeasures.begin(), kMeasures.end(), [name](const Measure& m) { return m.name == name; });
  CRAFTFLEET_CHECK(found != kMeasures.end());
  return *found;
}

}  // namespace craftfleet
