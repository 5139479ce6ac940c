#include "common/agent/agent_spec.h"

#include "common/agent/nets/network.h"
#include "common/agent_presets.h"
#include "common/status_macros.h"

namespace craftfleet {

absl::StatusOr<AgentSpec> MakeAgentSpec(const v1::RunConfig& config) {
  AgentSpec spec;
  spec.name = config.agent();
  CRAFTFLEET_ASSIGN_OR_RETURN(spec.network, ResolveNetwork(config));
  spec.frame_size = spec.network.frame_size();
  ParamList params;
  const Network network(spec.network, &params);
  spec.params = params.specs();
  spec.param_count = params.count();
  spec.state_size = static_cast<int>(network.state_size());
  return spec;
}

absl::StatusOr<AgentSpec> FindAgent(absl::string_view name) {
  v1::RunConfig config;
  config.set_agent(name.data(), name.size());
  return MakeAgentSpec(config);
}

}  // namespace craftfleet
