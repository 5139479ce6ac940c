// craftfleet agents: lists the agents and the parts of their networks.

#include <cstdio>
#include <string>
#include <vector>

#include <absl/flags/flag.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/strings/str_join.h>
#include <nlohmann/json.hpp>

#include "common/agent/agent_spec.h"
#include "common/base/numbers.h"
#include "common/base/status_macros.h"
#include "common/config/agent_presets.h"
#include "common/process/program.h"
#include "common/process/shared_flags.h"
#include "deploy/cli/command.h"

namespace craftfleet {
namespace {

using Network = v1::NetworkConfig;

constexpr char kProgram[] = "craftfleet agents";
constexpr char kUsage[] =
    R"(craftfleet agents lists the values of --agent, with the size of the frames, the parts of the network and the number of
parameters of each agent.

  craftfleet agents
  craftfleet agents --json
  craftfleet train --agent=lstm_cnn --logdir=runs/lstm)";

constexpr char kNotes[] = R"(
grid_distillation is recommended: of the agents that were trained for 1M steps here it scores highest. It is
achievement_distillation with a small residual network on the 9x9 cells of the picture; cnn_distillation has the network of
ppo_cnn.
ppo_resnet and achievement_distillation are from Moon et al. 2023, those before them from Stanic et al. 2022. Where that
paper differs from its published code, the plain name follows the paper, except in the critic of recurrent agents, the frames of
OC-SA and OC-CA, and OC-SA's patches and size of the CLS token. NAME_published follows the code in all but lanes and fragments:
with its learning rate (1e-4), deaths at the length limit and, for recurrent agents, minibatches. ppo_resnet_published has the
optimiser and advantages of its code.
"memory" is the change of features at the last achievement, "goals" the layers that distillation trains.
A configuration file (--config) may change any part of a network, for example: agent: "oc_ca" network { slots: 4 layer_norm: true }
)";

std::string Objects(const Network& network) {
  const std::string patches =
      absl::StrFormat("patches %d/%d, %d heads", network.patch(), network.stride(), network.heads());
  if (network.objects() == Network::SELF_ATTENTION) {
    return absl::StrFormat("self-attention: %s, %s CLS, %s", patches, network.cls_learned() ? "learned" : "zero",
                           network.positions() ? "positions" : "no positions");
  }
  if (network.objects() == Network::CROSS_ATTENTION) {
    std::vector<std::string> parts = {patches, absl::StrCat(network.slots(), " slots")};
    if (network.residual_mlp()) parts.emplace_back("residual MLP");
    if (network.layer_norm()) parts.emplace_back("LayerNorm");
    if (network.slot_competition()) parts.emplace_back("slot competition");
    return absl::StrCat("cross-attention: ", absl::StrJoin(parts, ", "));
  }
  return "-";
}

std::string Core(const Network& network) {
  if (network.memory()) return network.goal_predictor() ? "memory, goals" : "memory";
  if (!network.recurrent()) return network.goal_predictor() ? "goals" : "-";
  return network.critic() == Network::LSTM ? "LSTM, LSTM critic" : "LSTM, linear critic";
}

absl::Status Run() {
  nlohmann::ordered_json json = nlohmann::ordered_json::array();
  if (!absl::GetFlag(FLAGS_json)) {
    absl::PrintF("%-24s %5s  %-11s  %-20s %12s  %s\n", "agent", "frame", "extractor", "core", "parameters", "objects");
  }
  for (const absl::string_view name : AgentNames()) {
    CRAFTFLEET_ASSIGN_OR_RETURN(const AgentSpec spec, FindAgent(name));
    const std::string& extractor = Network::Extractor_Name(spec.network.extractor());
    if (absl::GetFlag(FLAGS_json)) {
      json.push_back({{"agent", spec.name},
                      {"frame_size", spec.frame_size},
                      {"extractor", extractor},
                      {"objects", Objects(spec.network)},
                      {"core", Core(spec.network)},
                      {"state_size", spec.state_size},
                      {"parameters", spec.param_count}});
      continue;
    }
    absl::PrintF("%-24s %5d  %-11s  %-20s %12s  %s\n", spec.name, spec.frame_size, extractor, Core(spec.network),
                 WithCommas(spec.param_count), Objects(spec.network));
  }
  std::fputs(absl::GetFlag(FLAGS_json) ? absl::StrCat(json.dump(2), "\n").c_str() : kNotes, stdout);
  return absl::OkStatus();
}

int RunAgents(int argc, char** argv) {
  ParseFlags({kProgram, kUsage, {"json"}, {}}, argc, argv);
  return ExitCode(kProgram, Run());
}

const RegisterCommand kRegistered("agents", &RunAgents);

}  // namespace
}  // namespace craftfleet
