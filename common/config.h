// A run's configuration: defaults, reading, checking and writing of RunConfig (proto/craftfleet/v1/config.proto).

#ifndef CRAFTFLEET_COMMON_CONFIG_H_
#define CRAFTFLEET_COMMON_CONFIG_H_

#include <string>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>

#include "craftfleet/v1/config.pb.h"

namespace craftfleet {

// PPO-CNN on Crafter with the paper's values (Stanic et al. 2022). Every field is set but `fragment_steps`, which
// follows from rollout and lanes: see ResolveRunConfig.
v1::RunConfig DefaultRunConfig();

// Reads protobuf text format over the defaults: a field left out keeps its default, a given one counts, 0 too.
//   InvalidArgument: "<filename>:<line>:<column>: ..." with the field and, if it is unknown, the known ones.
// Ranges are not checked here, because flags may still come on top.
absl::StatusOr<v1::RunConfig> ParseRunConfig(absl::string_view text, absl::string_view filename);

// Fills in `fragment_steps` where it is not given: the largest divisor of rollout_steps / lanes that is at most 256.
// Then checks the whole. What a program runs with comes from here.
//   InvalidArgument: as ValidateRunConfig.
absl::StatusOr<v1::RunConfig> ResolveRunConfig(v1::RunConfig config);

// Checks each value's range, then how they go together.
//   InvalidArgument: names the field, its value and its range. Whether agent and environment exist is for those who
//   build them to say.
absl::Status ValidateRunConfig(const v1::RunConfig& config);

// Text format, fields in the order of config.proto, numbers such that ParseRunConfig gives the same message.
std::string FormatRunConfig(const v1::RunConfig& config);

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_CONFIG_H_
