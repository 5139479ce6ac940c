// A run's configuration: defaults, reading, checking and writing of RunConfig (proto/craftfleet/v1/config.proto).

#ifndef CRAFTFLEET_COMMON_CONFIG_H_
#define CRAFTFLEET_COMMON_CONFIG_H_

#include <string>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>

#include "craftfleet/v1/config.pb.h"

namespace craftfleet {

// `agent` on Crafter with the paper's values (Stanic et al. 2022; ppo_resnet with its own). Every field is set but
// `network`, which the name stands for, and two that follow from others: `fragment_steps` (ResolveRunConfig) and
// `eval.env` (what it trains on).
//   InvalidArgument: unknown agent; lists the known ones.
absl::StatusOr<v1::RunConfig> DefaultRunConfig(absl::string_view agent);
v1::RunConfig DefaultRunConfig();  // of ppo_cnn

// Reads protobuf text format: what the file gives, nothing else. ResolveRunConfig adds the defaults.
//   InvalidArgument: "<filename>:<line>:<column>: ..." with the field and, if it is unknown, the known ones.
absl::StatusOr<v1::RunConfig> ParseRunConfig(absl::string_view text, absl::string_view filename);

// What a program runs with: `config` over the defaults of its agent (ppo_cnn if it names none), a given value counting
// even if it is 0. Fills in `fragment_steps` where it is not given: the largest divisor of rollout_steps / lanes that
// is at most 256, or 32 for recurrent agents, whose minibatches are made of whole fragments. Then checks the whole.
//   InvalidArgument: as ValidateRunConfig.
absl::StatusOr<v1::RunConfig> ResolveRunConfig(v1::RunConfig config);

// Checks each value's range, then how they go together.
//   InvalidArgument: names the field, its value and its range. Whether the environments exist is for those who build
//   them to say.
absl::Status ValidateRunConfig(const v1::RunConfig& config);

// Text format, fields in the order of config.proto, numbers such that ParseRunConfig gives the same message.
std::string FormatRunConfig(const v1::RunConfig& config);

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_CONFIG_H_
