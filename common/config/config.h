// A run's configuration: defaults, reading, checking and writing of RunConfig (proto/craftfleet/v1/config.proto).

#pragma once

#include <cstdint>
#include <string>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>

#include "craftfleet/v1/config.pb.h"

namespace craftfleet {

// Smallest observation, pixels: two for each of the nine cells of the view (envserver/render/picture_layout.cc).
inline constexpr int kMinFrameSize = 18;

// `agent` on Crafter with the paper's values, but for PPO.md, section 8 (Stanic et al. 2022; those of Moon et al. 2023
// with their own). Every field is set but `network`, which follows from the name, two that follow from others,
// `fragment_steps` (ResolveRunConfig) and `eval.env` (what it trains on), and five that are absent by default:
// `precision`, `device`, `overlap`, `max_staleness` and `acting_stream`.
//   InvalidArgument: unknown agent; lists the known ones.
absl::StatusOr<v1::RunConfig> DefaultRunConfig(absl::string_view agent);
v1::RunConfig DefaultRunConfig();  // of ppo_cnn

// Parses protobuf text format; only the given fields are set. ResolveRunConfig adds the defaults.
//   InvalidArgument: "<filename>:<line>:<column>: ..." with the field and, if it is unknown, the known ones.
absl::StatusOr<v1::RunConfig> ParseRunConfig(absl::string_view text, absl::string_view filename);

// The complete configuration: `config` on top of the defaults of its agent (ppo_cnn if it names none); explicit zeros
// are kept, except that `overlap: 0`, `max_staleness: 0`, `precision: FP32`, `device: CPU` and `acting_stream: false`
// are left out. The default of `fragment_steps` is the agent's, if it has one that divides rollout_steps / lanes, else
// the largest divisor of that which is at most 256, or 32 for recurrent agents, whose minibatches are made of whole
// fragments. Validates the result.
//   InvalidArgument: as ValidateRunConfig.
absl::StatusOr<v1::RunConfig> ResolveRunConfig(v1::RunConfig config);

// What differs between two configurations, for messages: field by field, as "modified: seed: 1 -> 2; ...". Empty:
// nothing.
std::string Differences(const v1::RunConfig& first, const v1::RunConfig& second);

// Checks the range of each value, then the relations between values.
//   InvalidArgument: names the field, its value and its range. Environment names are checked later, where the
//   environments are built.
absl::Status ValidateRunConfig(const v1::RunConfig& config);

// Environment steps after which the run of `config`, a complete one, ends: its `steps`, rounded up to whole iterations.
inline int64_t StepsToTrain(const v1::RunConfig& config) {
  const int64_t iteration = config.ppo().rollout_steps();
  return (config.steps() + iteration - 1) / iteration * iteration;
}

// Text format, fields in the order of config.proto. ParseRunConfig of the result yields the same message.
std::string FormatRunConfig(const v1::RunConfig& config);

}  // namespace craftfleet
