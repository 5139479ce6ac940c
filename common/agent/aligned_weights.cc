#include "common/agent/aligned_weights.h"

#include <algorithm>
#include <cstddef>

namespace craftfleet {
namespace {

constexpr int64_t kAlignment = 4;  // floats

}  // namespace

int64_t AlignedSize(int64_t size) { return (size + kAlignment - 1) / kAlignment * kAlignment; }

AgentSpec AlignedSpec(AgentSpec spec) {
  spec.param_count = 0;
  for (ParamSpec& param : spec.params) {
    param.offset = spec.param_count;
    spec.param_count += AlignedSize(param.size);
  }
  return spec;
}

std::vector<float> Align(const AgentSpec& spec, absl::Span<const float> values) {
  const AgentSpec aligned = AlignedSpec(spec);
  std::vector<float> result(static_cast<size_t>(aligned.param_count), 0.0F);
  for (size_t i = 0; i < spec.params.size(); ++i) {
    std::copy_n(values.data() + spec.params[i].offset, spec.params[i].size, result.data() + aligned.params[i].offset);
  }
  return result;
}

void Unalign(const AgentSpec& spec, const float* aligned, std::vector<float>* values) {
  for (const ParamSpec& param : spec.params) {
    std::copy_n(aligned, param.size, values->data() + param.offset);
    aligned += AlignedSize(param.size);
  }
}

}  // namespace craftfleet
