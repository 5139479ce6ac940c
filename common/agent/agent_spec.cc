#include "common/agent/agent_spec.h"

#include "common/agent/nets/network.h"
#include "common/base/status_macros.h"
#include "common/config/agent_presets.h"

namespace craftfleet {

absl::StatusOr<AgentSpec> MakeAgentSpec(const v1::RunConfig& config) {
  AgentSpec spec;
  spec.name = config.agent();
  CRAFTFLEET_ASSIGN_OR_RETURN(spec.network, ResolveNetwork(config));
  spec.frame_size = spec.network.frame_size();
  if (config.has_precision()) spec.precision = config.precision();
  spec.acting_stream = config.acting_stream();
  ParamList params;
  const Network network(spec.network, &params);
  spec.params = params.specs();
  spec.param_count = params.count();
  spec.state_size = static_cast<int>(network.state_size());
  spec.code_size = static_cast<int>(network.feature_size());
  return spec;
}

bool KeepsEveryState(const AgentSpec& spec, const v1::PpoConfig& ppo) {
  return spec.network.memory() || ppo.recurrent_batches() == v1::PpoConfig::PUBLISHED;
}

absl::StatusOr<AgentSpec> FindAgent(absl::string_view name) {
  v1::RunConfig config;
  config.set_agent(name.data(), name.size());
  return MakeAgentSpec(config);
}

}  // namespace craftfleet
