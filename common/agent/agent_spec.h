// The agents by name: their frames and parameters (AGENTS.md). Does not include LibTorch.

#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>

#include "common/agent/nets/params.h"
#include "craftfleet/v1/config.pb.h"

namespace craftfleet {

struct AgentSpec {
  std::string name;                                          // "ppo_cnn"
  v1::NetworkConfig network;                                 // complete
  int frame_size = 0;                                        // pixels, width and height of the frames it wants
  std::vector<ParamSpec> params;                             // offsets ascending, without gaps
  int64_t param_count = 0;                                   // values, all parameters together
  v1::RunConfig::Precision precision = v1::RunConfig::FP32;  // of convolutions and linear layers
  bool acting_stream = false;                                // policies on a GPU compute beside its updates
  int state_size = 0;  // floats of state a lane: h and c of each LSTM, or a memory; 0: none
  int code_size = 0;   // floats of features (F)

  int64_t frame_bytes() const { return int64_t{3} * frame_size * frame_size; }  // of one frame uint8[H,W,3]
};

// The agent of a run: the preset named by `agent`, with the overrides in `network`.
//   InvalidArgument: as ResolveNetwork (common/config/agent_presets.h).
absl::StatusOr<AgentSpec> MakeAgentSpec(const v1::RunConfig& config);

// Whether fragments hold the state before each step, which updates need then, not only that before the first.
bool KeepsEveryState(const AgentSpec& spec, const v1::PpoConfig& ppo);

// The agent of this name without overrides.
//   InvalidArgument: unknown name; lists the known ones.
absl::StatusOr<AgentSpec> FindAgent(absl::string_view name);

}  // namespace craftfleet
