// The agents by name. A preset is a configuration with only the fields that the agent sets itself.

#pragma once

#include <vector>

#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>

#include "craftfleet/v1/config.pb.h"

namespace craftfleet {

// In the order of AGENTS.md, section 1. Names such as `oc_sa` follow the paper's text but for section 8 there, names
// such as `oc_sa_published` the code that its authors published.
std::vector<absl::string_view> AgentNames();

// The fields that `agent` sets: all of `network`, hyperparameters only where they differ from PPO-CNN's.
// Source: Stanic et al. 2022 and, from ppo_resnet on, Moon et al. 2023; AGENTS.md.
//   InvalidArgument: unknown name; lists the known ones.
absl::StatusOr<v1::RunConfig> AgentPreset(absl::string_view agent);

// The network of a run: the preset of `config.agent`, overridden by the fields that `config.network` sets.
//   InvalidArgument: unknown agent; a value out of range; parts that don't go together; a value for a part that the
//   network does not have. Names the field.
absl::StatusOr<v1::NetworkConfig> ResolveNetwork(const v1::RunConfig& config);

}  // namespace craftfleet
