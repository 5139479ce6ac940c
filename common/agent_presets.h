// What the agents' names stand for: each is a configuration that says only what is its own.

#ifndef CRAFTFLEET_COMMON_AGENT_PRESETS_H_
#define CRAFTFLEET_COMMON_AGENT_PRESETS_H_

#include <vector>

#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>

#include "craftfleet/v1/config.pb.h"

namespace craftfleet {

// In the order of "The agents", section 6. `oc_sa` and the like follow the paper's text, `oc_sa_published` and the like
// the code that its authors published.
std::vector<absl::string_view> AgentNames();

// What `agent` says for itself: `network` whole, hyperparameters only where they differ from PPO-CNN's.
// Source: Stanic et al. 2022 and, for ppo_resnet, Moon et al. 2023; "The agents", sections 4 to 6 and 9.
//   InvalidArgument: unknown name; lists the known ones.
absl::StatusOr<v1::RunConfig> AgentPreset(absl::string_view agent);

// The network of a run: the preset of `config.agent`, with what `config.network` gives in its place.
//   InvalidArgument: unknown agent; a value out of range; parts that don't go together; a value for a part that the
//   network does not have. Names the field.
absl::StatusOr<v1::NetworkConfig> ResolveNetwork(const v1::RunConfig& config);

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_AGENT_PRESETS_H_
