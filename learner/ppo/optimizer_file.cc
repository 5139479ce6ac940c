#include "learner/ppo/optimizer_file.h"

#include <cmath>
#include <string>
#include <utility>

#include <absl/strings/numbers.h>
#include <absl/strings/str_cat.h>
#include <absl/types/span.h>

#include "common/agent/weights.h"
#include "common/base/numbers.h"
#include "common/base/status_macros.h"

namespace craftfleet {
namespace {

constexpr char kStepsKey[] = "steps";
constexpr char kExpAvg[] = "exp_avg.";
constexpr char kExpAvgSq[] = "exp_avg_sq.";
constexpr char kValueMean[] = "value_norm.mean";
constexpr char kValueMeanSquare[] = "value_norm.mean_square";
constexpr char kValueWeight[] = "value_norm.weight";

absl::StatusOr<double> ReadNumber(const SafeTensors& file, absl::string_view key) {
  const auto entry = file.metadata.find(std::string(key));
  double number = 0;
  if (entry != file.metadata.end() && absl::SimpleAtod(entry->second, &number) && std::isfinite(number)) return number;
  return absl::InvalidArgumentError(absl::StrCat("the optimiser's metadata \"", key, "\" is not a number"));
}

}  // namespace

void AddAdam(const AgentSpec& spec, absl::string_view prefix, const AdamState& adam, SafeTensors* file) {
  file->metadata[absl::StrCat(prefix, kStepsKey)] = absl::StrCat(adam.steps);
  for (const auto& [name, moments] : {std::pair(kExpAvg, &adam.exp_avg), std::pair(kExpAvgSq, &adam.exp_avg_sq)}) {
    for (SafeTensor& tensor : AsTensors(spec, absl::StrCat(prefix, name), *moments)) {
      file->tensors.push_back(std::move(tensor));
    }
  }
}

void AddValueNorm(const ValueNorm& value_norm, SafeTensors* file) {
  file->metadata[kValueMean] = ExactNumber(value_norm.mean);
  file->metadata[kValueMeanSquare] = ExactNumber(value_norm.mean_square);
  file->metadata[kValueWeight] = ExactNumber(value_norm.weight);
}

bool HasValueNorm(const SafeTensors& file) { return file.metadata.count(kValueWeight) > 0; }

absl::StatusOr<AdamState> ReadAdam(const AgentSpec& spec, absl::string_view prefix, const SafeTensors& file) {
  AdamState adam;
  for (const auto& [name, moments] : {std::pair(kExpAvg, &adam.exp_avg), std::pair(kExpAvgSq, &adam.exp_avg_sq)}) {
    moments->resize(spec.param_count);
    CRAFTFLEET_RETURN_IF_ERROR(CopyTensors(spec, absl::StrCat(prefix, name), file.tensors, absl::MakeSpan(*moments)));
  }
  for (size_t i = 0; i < adam.exp_avg.size(); ++i) {
    if (std::isfinite(adam.exp_avg[i]) && std::isfinite(adam.exp_avg_sq[i]) && adam.exp_avg_sq[i] >= 0) continue;
    return absl::InvalidArgumentError(absl::StrCat("the optimiser's moments of weight ", i, " are ", adam.exp_avg[i],
                                                   " and ", adam.exp_avg_sq[i],
                                                   ", want finite numbers, the second not negative"));
  }
  const std::string key = absl::StrCat(prefix, kStepsKey);
  const auto steps = file.metadata.find(key);
  if (steps == file.metadata.end() || !absl::SimpleAtoi(steps->second, &adam.steps) || adam.steps < 0) {
    return absl::InvalidArgumentError(absl::StrCat("the optimiser's metadata \"", key, "\" is not a count"));
  }
  return adam;
}

absl::StatusOr<ValueNorm> ReadValueNorm(const SafeTensors& file) {
  ValueNorm value_norm;
  CRAFTFLEET_ASSIGN_OR_RETURN(value_norm.mean, ReadNumber(file, kValueMean));
  CRAFTFLEET_ASSIGN_OR_RETURN(value_norm.mean_square, ReadNumber(file, kValueMeanSquare));
  CRAFTFLEET_ASSIGN_OR_RETURN(value_norm.weight, ReadNumber(file, kValueWeight));
  CRAFTFLEET_RETURN_IF_ERROR(value_norm.Check());
  return value_norm;
}

}  // namespace craftfleet
