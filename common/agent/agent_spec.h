// The agents by name: what they look at and which parameters they have. No LibTorch here.

#ifndef CRAFTFLEET_COMMON_AGENT_AGENT_SPEC_H_
#define CRAFTFLEET_COMMON_AGENT_AGENT_SPEC_H_

#include <cstdint>
#include <string>
#include <vector>

#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>

namespace craftfleet {

// One tensor of a network. All parameters of an agent lie in one flat array, each row-major, in the spec's order.
struct ParamSpec {
  std::string name;            // "features_extractor.cnn.0.weight": also its name in saved weights
  std::vector<int64_t> shape;  // linear [out, in], convolution [out, in, k, k]
  int64_t offset = 0;          // of its first value in the flat array
  int64_t size = 0;            // values
  double gain = 0;             // it starts orthogonal, [out, everything else], times this; 0: it starts at zero
};

struct AgentSpec {
  std::string name;               // "ppo_cnn"
  int frame_size = 0;             // pixels, width and height of the frames it wants
  std::vector<ParamSpec> params;  // offsets ascending, without gaps
  int64_t param_count = 0;        // values, all parameters together

  int64_t frame_bytes() const { return int64_t{3} * frame_size * frame_size; }  // of one frame uint8[H,W,3]
};

// Source: Stanic et al. 2022; layers as in "The agents", sections 2, 3 and 6.
//   InvalidArgument: unknown name; lists the known ones.
absl::StatusOr<AgentSpec> FindAgent(absl::string_view name);

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_AGENT_AGENT_SPEC_H_
