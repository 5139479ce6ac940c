// The agents by name: what they look at and which parameters they have. No LibTorch here.

#ifndef CRAFTFLEET_COMMON_AGENT_AGENT_SPEC_H_
#define CRAFTFLEET_COMMON_AGENT_AGENT_SPEC_H_

#include <cstdint>
#include <string>
#include <vector>

#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>

#include "common/agent/nets/params.h"
#include "craftfleet/v1/config.pb.h"

namespace craftfleet {

struct AgentSpec {
  std::string name;               // "ppo_cnn"
  v1::NetworkConfig network;      // complete
  int frame_size = 0;             // pixels, width and height of the frames it wants
  std::vector<ParamSpec> params;  // offsets ascending, without gaps
  int64_t param_count = 0;        // values, all parameters together
  int state_size = 0;             // floats of recurrent state a lane: h and c of each LSTM; 0: feed-forward

  int64_t frame_bytes() const { return int64_t{3} * frame_size * frame_size; }  // of one frame uint8[H,W,3]
};

// The agent that a run's `agent` names, with the changes of its `network`.
//   InvalidArgument: as ResolveNetwork (common/agent_presets.h).
absl::StatusOr<AgentSpec> MakeAgentSpec(const v1::RunConfig& config);

// The agent as its name stands.
//   InvalidArgument: unknown name; lists the known ones.
absl::StatusOr<AgentSpec> FindAgent(absl::string_view name);

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_AGENT_AGENT_SPEC_H_
