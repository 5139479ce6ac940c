// Optimisers and value statistics as tensors and metadata of a safetensors file. Format: FORMATS.md, section 7.

#pragma once

#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>

#include "common/agent/agent_spec.h"
#include "common/agent/safetensors.h"
#include "learner/ppo/adam.h"
#include "learner/ppo/value_norm.h"

namespace craftfleet {

// Adds `adam`, with the names of its tensors and metadata behind `prefix`.
void AddAdam(const AgentSpec& spec, absl::string_view prefix, const AdamState& adam, SafeTensors* file);
void AddValueNorm(const ValueNorm& value_norm, SafeTensors* file);

bool HasValueNorm(const SafeTensors& file);

// Read what the functions above added.
//   InvalidArgument: it is missing or not this agent's; names the tensor or number.
absl::StatusOr<AdamState> ReadAdam(const AgentSpec& spec, absl::string_view prefix, const SafeTensors& file);
absl::StatusOr<ValueNorm> ReadValueNorm(const SafeTensors& file);

}  // namespace craftfleet
