// The order of an agent's weights in a device's memory.

#pragma once

#include <cstdint>
#include <vector>

#include <absl/types/span.h>

#include "common/agent/agent_spec.h"

namespace craftfleet {

// `size` floats and the zeros behind them, to the next multiple of 16 bytes, as the quick kernels of a GPU want it.
int64_t AlignedSize(int64_t size);

// `spec` with each parameter at such a multiple: its offsets, and the count of all with the zeros between.
AgentSpec AlignedSpec(AgentSpec spec);

// `values` float[spec.param_count] in the order of AlignedSpec, with zeros between.
std::vector<float> Align(const AgentSpec& spec, absl::Span<const float> values);

// The reverse of Align.
void Unalign(const AgentSpec& spec, const float* aligned, std::vector<float>* values);

}  // namespace craftfleet
