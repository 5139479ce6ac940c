#include "common/agent/agent_spec.h"

#include <array>
#include <cmath>
#include <utility>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_join.h>

#include "common/crafter.h"

namespace craftfleet {
namespace {

// Adds `name`.weight, orthogonal times `gain`, and `name`.bias, zero.
void AddLayer(const std::string& name, std::vector<int64_t> weight_shape, double gain, AgentSpec* spec) {
  const int64_t outputs = weight_shape[0];
  const auto add = [spec](std::string param_name, std::vector<int64_t> shape, double param_gain) {
    ParamSpec param{std::move(param_name), std::move(shape), spec->param_count, 1, param_gain};
    for (const int64_t length : param.shape) param.size *= length;
    spec->param_count += param.size;
    spec->params.push_back(std::move(param));
  };
  add(name + ".weight", std::move(weight_shape), gain);
  add(name + ".bias", {outputs}, 0);
}

// The feature extractor of DQN (Mnih et al. 2015), for frames of 64 pixels: 512 features.
void AddCnn(AgentSpec* spec) {
  const double gain = std::sqrt(2.0);
  AddLayer("features_extractor.cnn.0", {32, 3, 8, 8}, gain, spec);
  AddLayer("features_extractor.cnn.2", {64, 32, 4, 4}, gain, spec);
  AddLayer("features_extractor.cnn.4", {64, 64, 3, 3}, gain, spec);
  AddLayer("features_extractor.outmap.0", {512, 1024}, gain, spec);
}

void AddHeads(int64_t features, AgentSpec* spec) {
  AddLayer("action_net", {kNumActions, features}, 0.01, spec);
  AddLayer("value_net", {1, features}, 1, spec);
}

AgentSpec PpoCnn() {
  AgentSpec spec{"ppo_cnn", 64, {}, 0};
  AddCnn(&spec);
  AddHeads(512, &spec);
  return spec;
}

struct RegisteredAgent {
  absl::string_view name;
  AgentSpec (*build)();
};
constexpr std::array<RegisteredAgent, 1> kAgents = {{{"ppo_cnn", PpoCnn}}};

}  // namespace

absl::StatusOr<AgentSpec> FindAgent(absl::string_view name) {
  std::vector<absl::string_view> known;
  for (const RegisteredAgent& agent : kAgents) {
    if (agent.name == name) return agent.build();
    known.push_back(agent.name);
  }
  return absl::InvalidArgumentError(
      absl::StrCat("agent \"", name, "\" is unknown; known agents: ", absl::StrJoin(known, ", ")));
}

}  // namespace craftfleet
