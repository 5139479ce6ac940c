#include "common/config/agent_presets.h"

#include <algorithm>
#include <array>
#include <cstdint>
#include <string>

#include <absl/status/status.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_join.h>
#include <google/protobuf/text_format.h>

#include "common/base/check.h"
#include "common/base/numbers.h"
#include "common/base/range_check.h"
#include "common/base/status_macros.h"

namespace craftfleet {
namespace {

using google::protobuf::TextFormat;
using Network = v1::NetworkConfig;

struct Preset {
  absl::string_view name;
  absl::string_view base;  // the agent that it is a variant of, or ""
  const char* text;        // fields set on top of the base's
};

// As in the published code: truncation counts as death, padding enters the loss, a third of the learning rate.
constexpr char kAsPublished[] = "ppo { learning_rate: 1e-4 truncation_is_terminal: true recurrent_batches: PUBLISHED }";

constexpr std::array kPresets = {
    Preset{"ppo_cnn", "", "network { extractor: CNN frame_size: 64 objects: NO_OBJECTS recurrent: false }"},
    Preset{"lstm_cnn", "ppo_cnn", "network { recurrent: true critic: LINEAR }"},
    Preset{"lstm_cnn_published", "lstm_cnn", kAsPublished},
    Preset{"ppo_spcnn", "ppo_cnn", "network { extractor: SPCNN }"},
    Preset{"lstm_spcnn", "ppo_spcnn", "network { recurrent: true critic: LINEAR }"},
    Preset{"lstm_spcnn_published", "lstm_spcnn", kAsPublished},
    Preset{"oc_sa", "ppo_spcnn",
           "network { frame_size: 72 objects: SELF_ATTENTION patch: 12 stride: 8 heads: 8 cls_learned: true "
           "positions: true dropout: 0.1 }"},
    Preset{"oc_sa_published", "oc_sa",
           "network { cls_learned: false positions: false } ppo { learning_rate: 1e-4 truncation_is_terminal: true }"},
    Preset{"oc_ca", "ppo_spcnn",
           "network { frame_size: 72 objects: CROSS_ATTENTION patch: 16 stride: 16 heads: 8 slots: 8 dropout: 0 "
           "residual_mlp: false layer_norm: false slot_competition: false }"},
    Preset{"oc_ca_published", "oc_ca", "network { heads: 4 } ppo { learning_rate: 1e-4 truncation_is_terminal: true }"},
    Preset{"ppo_resnet", "ppo_cnn",
           "network { extractor: RESNET } lanes: 8 ppo { epochs: 3 minibatch_size: 512 entropy_coefficient: 0.01 "
           "value_norm_decay: 0.99 }"},
    // As in the published code of Moon et al.: an iteration of a lane is one fragment.
    Preset{"ppo_resnet_published", "ppo_resnet",
           "fragment_steps: 512 ppo { adam_epsilon: 1e-8 truncation_is_terminal: true value_norm_start: 0.1 "
           "advantages_over_rollout: true }"},
    // A checkpoint between two phases has the rollouts since the last one: up to 400 MB.
    Preset{"achievement_distillation", "ppo_resnet_published",
           "network { memory: true goal_predictor: true } distillation { every_iterations: 8 } "
           "checkpoint { every_iterations: 8 }"},
    // Not from a paper. At 1M steps they score 14.7 ± 2.9 and 18.2 ± 0.7 (three seeds each).
    Preset{"cnn_distillation", "achievement_distillation", "network { extractor: CNN }"},
    Preset{"grid_distillation", "achievement_distillation", "network { extractor: GRID_RESNET }"},
};

const Preset* Find(absl::string_view name) {
  const auto* found = std::find_if(kPresets.begin(), kPresets.end(), [&](const Preset& p) { return p.name == name; });
  return found == kPresets.end() ? nullptr : found;
}

v1::RunConfig Build(const Preset& preset) {
  v1::RunConfig config;
  if (!preset.base.empty()) config = Build(*Find(preset.base));
  v1::RunConfig own;
  CRAFTFLEET_CHECK(TextFormat::ParseFromString(preset.text, &own));
  config.MergeFrom(own);
  return config;
}

constexpr int kMaxFrameSize = 256;    // pixels; an SPCNN's linear layer grows with its square
constexpr int kMinCnnFrameSize = 36;  // pixels; below, the last convolution's input is smaller than its kernel
constexpr int kAttentionWidth = 256;  // all heads together
constexpr int kMaxSlots = 256;
constexpr int kResnetWidth = 64;  // channels; Moon et al. 2023
constexpr int kGridResnetWidth = 32;

bool HasWidth(const Network& network) {
  return network.extractor() == Network::RESNET || network.extractor() == Network::GRID_RESNET;
}

// InvalidArgument if `given` sets a field that the network does not use.
absl::Status CheckGivenFields(const Network& given, const Network& network) {
  const bool self_attention = network.objects() == Network::SELF_ATTENTION;
  const bool cross_attention = network.objects() == Network::CROSS_ATTENTION;
  const bool objects = self_attention || cross_attention;
  RangeCheck check;
  const auto wants = [&](bool is_given, const char* field, bool is_used, const char* part) {
    check.That(!is_given || is_used, absl::StrCat("network.", field, " is given, but only ", part, " has it"));
  };
  wants(given.has_patch(), "patch", objects, "a network with objects");
  wants(given.has_stride(), "stride", objects, "a network with objects");
  wants(given.has_heads(), "heads", objects, "a network with objects");
  wants(given.has_dropout(), "dropout", objects, "a network with objects");
  wants(given.has_cls_learned(), "cls_learned", self_attention, "objects: SELF_ATTENTION");
  wants(given.has_positions(), "positions", self_attention, "objects: SELF_ATTENTION");
  wants(given.has_slots(), "slots", cross_attention, "objects: CROSS_ATTENTION");
  wants(given.has_residual_mlp(), "residual_mlp", cross_attention, "objects: CROSS_ATTENTION");
  wants(given.has_layer_norm(), "layer_norm", cross_attention, "objects: CROSS_ATTENTION");
  wants(given.has_slot_competition(), "slot_competition", cross_attention, "objects: CROSS_ATTENTION");
  wants(given.has_critic(), "critic", network.recurrent(), "recurrent: true");
  wants(given.has_width(), "width", HasWidth(network), "extractor: RESNET or GRID_RESNET");
  return check.status();
}

absl::Status CheckObjects(const Network& network) {
  RangeCheck check;
  check.That(network.extractor() == Network::SPCNN,
             absl::StrCat("network.extractor is ", Network::Extractor_Name(network.extractor()),
                          ", want SPCNN: object modules look at its map"));
  check.Within("network.patch", network.patch(), 1, network.frame_size());
  check.Within("network.stride", network.stride(), 1, network.frame_size());
  check.Within("network.heads", network.heads(), 1, kAttentionWidth);
  check.That(network.heads() < 1 || kAttentionWidth % network.heads() == 0,
             absl::StrCat("network.heads is ", network.heads(), ", want a divisor of ", kAttentionWidth));
  check.That(network.dropout() >= 0 && network.dropout() < 1,
             absl::StrCat("network.dropout is ", ExactNumber(network.dropout()), ", want at least 0, less than 1"));
  if (network.objects() == Network::CROSS_ATTENTION) check.Within("network.slots", network.slots(), 1, kMaxSlots);
  return check.status();
}

absl::Status CheckNetwork(const Network& network) {
  RangeCheck check;
  const bool known_extractor =
      network.extractor() != Network::EXTRACTOR_UNSPECIFIED && Network::Extractor_IsValid(network.extractor());
  check.That(known_extractor,
             "network.extractor is EXTRACTOR_UNSPECIFIED or unknown, want CNN, SPCNN, RESNET or GRID_RESNET");
  const bool known_objects =
      network.objects() != Network::OBJECT_MODULE_UNSPECIFIED && Network::ObjectModule_IsValid(network.objects());
  check.That(
      known_objects,
      "network.objects is OBJECT_MODULE_UNSPECIFIED or unknown, want NO_OBJECTS, SELF_ATTENTION or CROSS_ATTENTION");
  const bool known_critic =
      network.critic() != Network::CRITIC_UNSPECIFIED && Network::Critic_IsValid(network.critic());
  check.That(!network.recurrent() || known_critic,
             "network.critic is CRITIC_UNSPECIFIED or unknown, want LINEAR or LSTM");
  // Each of the nine rows of tiles needs at least one pixel.
  const int least_size = network.extractor() == Network::CNN ? kMinCnnFrameSize : 9;
  check.Within("network.frame_size", network.frame_size(), least_size, kMaxFrameSize);
  if (HasWidth(network)) check.Within("network.width", network.width(), 1, 256);
  const bool plain = network.objects() == Network::NO_OBJECTS && !network.recurrent();
  check.That(!network.memory() || plain, "network.memory is true, want NO_OBJECTS and recurrent: false with it");
  check.That(!network.goal_predictor() || plain,
             "network.goal_predictor is true, want NO_OBJECTS and recurrent: false with it");
  CRAFTFLEET_RETURN_IF_ERROR(check.status());
  return network.objects() == Network::NO_OBJECTS ? absl::OkStatus() : CheckObjects(network);
}

}  // namespace

std::vector<absl::string_view> AgentNames() {
  std::vector<absl::string_view> names;
  names.reserve(kPresets.size());
  for (const Preset& preset : kPresets) names.push_back(preset.name);
  return names;
}

absl::StatusOr<v1::RunConfig> AgentPreset(absl::string_view agent) {
  const Preset* preset = Find(agent);
  if (preset == nullptr) {
    return absl::InvalidArgumentError(
        absl::StrCat("agent \"", agent, "\" is unknown; known agents: ", absl::StrJoin(AgentNames(), ", ")));
  }
  return Build(*preset);
}

absl::StatusOr<v1::NetworkConfig> ResolveNetwork(const v1::RunConfig& config) {
  CRAFTFLEET_ASSIGN_OR_RETURN(const v1::RunConfig preset, AgentPreset(config.agent()));
  Network network = preset.network();
  network.MergeFrom(config.network());
  if (network.extractor() == Network::RESNET && !network.has_width()) network.set_width(kResnetWidth);
  if (network.extractor() == Network::GRID_RESNET && !network.has_width()) network.set_width(kGridResnetWidth);
  CRAFTFLEET_RETURN_IF_ERROR(CheckNetwork(network));
  CRAFTFLEET_RETURN_IF_ERROR(CheckGivenFields(config.network(), network));
  return network;
}

}  // namespace craftfleet
