// An agent's weights <-> bytes (safetensors).

#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>
#include <absl/types/span.h>

#include "common/agent/agent_spec.h"
#include "common/agent/safetensors.h"

namespace craftfleet {

// A view of `values`, float[spec.param_count], as the spec's tensors, each name behind `prefix`.
std::vector<SafeTensor> AsTensors(const AgentSpec& spec, absl::string_view prefix, absl::Span<const float> values);

// Copies the tensors whose names begin with `prefix` into `values`, float[spec.param_count], untouched on failure.
//   InvalidArgument: one is missing, unknown or of another shape; named.
absl::Status CopyTensors(const AgentSpec& spec, absl::string_view prefix, absl::Span<const SafeTensor> tensors,
                         absl::Span<float> values);

// `weights` is float[spec.param_count].
std::string SaveWeights(const AgentSpec& spec, absl::Span<const float> weights);

// The most bytes that SaveWeights returns for this agent: its values, and a header with a wide margin. Receivers of
// weights refuse more.
int64_t MaxWeightsBytes(const AgentSpec& spec);

// The inverse. `bytes` may be untrusted.
//   InvalidArgument: not safetensors, or not this agent's parameters; names the parameter.
absl::StatusOr<std::vector<float>> LoadWeights(const AgentSpec& spec, absl::string_view bytes);

// The same without a copy where `bytes` are as SaveWeights writes them: float[spec.param_count], owned by the result.
absl::StatusOr<std::shared_ptr<const float>> ShareWeights(const AgentSpec& spec,
                                                          std::shared_ptr<const std::string> bytes);

}  // namespace craftfleet
