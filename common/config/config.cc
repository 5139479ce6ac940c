#include "common/config/config.h"

#include <algorithm>
#include <cstdint>
#include <limits>
#include <utility>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_join.h>
#include <absl/strings/str_split.h>
#include <absl/strings/string_view.h>
#include <google/protobuf/text_format.h>
#include <google/protobuf/util/message_differencer.h>

#include "common/base/check.h"
#include "common/base/numbers.h"
#include "common/base/range_check.h"
#include "common/base/status_macros.h"
#include "common/config/agent_presets.h"
#include "common/config/text_format.h"

namespace craftfleet {
namespace {

constexpr absl::string_view kDefaultAgent = "ppo_cnn";
constexpr int32_t kMaxDerivedFragmentSteps = 256;
constexpr int32_t kMaxDerivedRecurrentFragmentSteps = 32;

absl::Status CheckRanges(const v1::RunConfig& config) {
  RangeCheck check;
  check.Named("agent", config.agent());
  check.Named("env.name", config.env().name());
  // Each of the nine rows of tiles needs at least one pixel; 0 selects the agent's own size.
  if (config.env().frame_size() != 0) check.Within("env.frame_size", config.env().frame_size(), kMinFrameSize, 1024);
  check.Within("env.length", config.env().length(), 0, 1'000'000'000);  // the most that worlds allow
  check.Within("steps", config.steps(), int64_t{1}, int64_t{1'000'000'000'000});
  check.Within("lanes", config.lanes(), 1, 4096);
  check.Within("tile", config.tile(), 1, 256);
  check.Within("gradient_shards", config.gradient_shards(), 1, 256);
  const bool known_cpu = config.cpu() != v1::RunConfig::CPU_UNSPECIFIED && v1::RunConfig::Cpu_IsValid(config.cpu());
  check.That(known_cpu, "cpu is CPU_UNSPECIFIED or unknown, want NATIVE, AVX2 or AVX512");
  check.Within("overlap", config.overlap(), 0, 1);
  check.Within("max_staleness", config.max_staleness(), 0, 64);
  const bool known_precision = config.precision() != v1::RunConfig::PRECISION_UNSPECIFIED &&
                               v1::RunConfig::Precision_IsValid(config.precision());
  check.That(!config.has_precision() || known_precision,
             "precision is PRECISION_UNSPECIFIED or unknown, want FP32, TF32 or BF16");
  const bool known_device =
      config.device() != v1::RunConfig::DEVICE_UNSPECIFIED && v1::RunConfig::Device_IsValid(config.device());
  check.That(!config.has_device() || known_device,
             "device is DEVICE_UNSPECIFIED or unknown, want CPU, CUDA or CUDA_UPDATES");
  const v1::PpoConfig& ppo = config.ppo();
  check.Within("ppo.rollout_steps", ppo.rollout_steps(), 1, 1 << 24);
  // Before fragment_steps, whose default is derived from both.
  if (check.status().ok()) check.Multiple("ppo.rollout_steps", ppo.rollout_steps(), "lanes", config.lanes());
  check.Within("fragment_steps", config.fragment_steps(), 1, 16384);
  check.Within("ppo.minibatch_size", ppo.minibatch_size(), 1, 1 << 20);
  check.Within("ppo.epochs", ppo.epochs(), 1, 1000);
  check.Within("ppo.learning_rate", ppo.learning_rate(), 0.0, 1.0);
  check.Within("ppo.gamma", ppo.gamma(), 0.0, 1.0);
  check.Within("ppo.gae_lambda", ppo.gae_lambda(), 0.0, 1.0);
  check.Positive("ppo.clip", ppo.clip(), 10);
  check.Within("ppo.value_coefficient", ppo.value_coefficient(), 0.0, 100.0);
  check.Within("ppo.entropy_coefficient", ppo.entropy_coefficient(), 0.0, 100.0);
  check.Positive("ppo.max_gradient_norm", ppo.max_gradient_norm(), 1e6);
  // As a float32 it must not be 0: the second moment may be 0.
  check.Within("ppo.adam_epsilon", ppo.adam_epsilon(), 1e-30, 1.0);
  check.That(
      ppo.value_norm_decay() >= 0 && ppo.value_norm_decay() < 1,
      absl::StrCat("ppo.value_norm_decay is ", ExactNumber(ppo.value_norm_decay()), ", want at least 0, less than 1"));
  check.Positive("ppo.value_norm_start", ppo.value_norm_start(), 100);
  const v1::DistillationConfig& distillation = config.distillation();
  check.Within("distillation.every_iterations", distillation.every_iterations(), 0, 1000);
  check.Within("distillation.epochs", distillation.epochs(), 0, 1000);
  check.Within("distillation.minibatch_size", distillation.minibatch_size(), 1, 1 << 20);
  check.Within("distillation.targets", distillation.targets(), 0, 1000);
  check.Within("distillation.temperature", distillation.temperature(), 1e-3, 1000.0);
  check.Within("distillation.transport_regularization", distillation.transport_regularization(), 1e-3, 1000.0);
  check.Within("distillation.transport_rounds", distillation.transport_rounds(), 1, 10'000);
  check.Within("distillation.match_threshold", distillation.match_threshold(), 0.0, 1.0);
  check.Within("checkpoint.every_iterations", config.checkpoint().every_iterations(), 1, 1'000'000);
  check.Within("checkpoint.keep", config.checkpoint().keep(), 1, 1000);
  const v1::EvalConfig& eval = config.eval();
  check.Within("eval.every_steps", eval.every_steps(), int64_t{0}, int64_t{1'000'000'000'000});
  check.Within("eval.episodes", eval.episodes(), 0, 10'000);
  check.Within("eval.final_episodes", eval.final_episodes(), 0, 10'000);
  check.Within("eval.seed", eval.seed(), int64_t{0}, int64_t{std::numeric_limits<int32_t>::max()});
  return check.status();
}

// Needs values within their ranges.
absl::Status CheckRelations(const v1::RunConfig& config) {
  CRAFTFLEET_ASSIGN_OR_RETURN(const v1::NetworkConfig network, ResolveNetwork(config));
  RangeCheck check;
  const v1::PpoConfig& ppo = config.ppo();
  const bool known_batches = ppo.recurrent_batches() != v1::PpoConfig::RECURRENT_BATCHES_UNSPECIFIED &&
                             v1::PpoConfig::RecurrentBatches_IsValid(ppo.recurrent_batches());
  check.That(!network.recurrent() || known_batches,
             "ppo.recurrent_batches is RECURRENT_BATCHES_UNSPECIFIED or unknown, want SEGMENTS or PUBLISHED");
  check.Multiple("ppo.rollout_steps", ppo.rollout_steps(), "lanes * fragment_steps",
                 int64_t{config.lanes()} * config.fragment_steps());
  check.Multiple("ppo.rollout_steps", ppo.rollout_steps(), "ppo.minibatch_size", ppo.minibatch_size());
  check.Multiple("ppo.minibatch_size", ppo.minibatch_size(), "gradient_shards", config.gradient_shards());
  if (config.max_staleness() > 0) {
    check.That(config.overlap() == 0,
               "overlap and max_staleness are both given, but each says which weights play: want one of them");
    check.That(
        config.distillation().every_iterations() == 0,
        "distillation.every_iterations and max_staleness are both given: distillation needs as many steps of each "
        "lane from every iteration, and asynchronous play takes them as they arrive: want one of them");
  }
  check.That(config.distillation().every_iterations() == 0 || network.goal_predictor(),
             "distillation.every_iterations is given, but the network has no goal_predictor to train: want network { "
             "goal_predictor: true }");
  check.That(
      config.precision() != v1::RunConfig::BF16 || config.cpu() != v1::RunConfig::AVX2 ||
          config.device() == v1::RunConfig::CUDA,
      "precision is BF16 and cpu is AVX2, which has no bfloat16: want cpu: NATIVE or AVX512, or precision: FP32");
  return check.status();
}

// The defaults of all agents; a preset may override them (common/config/agent_presets.cc).
constexpr char kPaperConfig[] = R"(
  env { name: "crafter" frame_size: 0 length: 0 }
  steps: 1000000
  seed: 0
  lanes: 16
  tile: 8
  gradient_shards: 2
  cpu: NATIVE
  ppo {
    rollout_steps: 4096 minibatch_size: 128 epochs: 4 learning_rate: 3e-4 gamma: 0.95 gae_lambda: 0.65 clip: 0.2
    value_coefficient: 0.5 entropy_coefficient: 0 max_gradient_norm: 0.5 adam_epsilon: 1e-5
    truncation_is_terminal: false recurrent_batches: SEGMENTS value_norm_decay: 0 value_norm_start: 1
    advantages_over_rollout: false
  }
  distillation {
    every_iterations: 0 epochs: 6 minibatch_size: 512 targets: 16 temperature: 0.1 transport_regularization: 0.05
    transport_rounds: 100 match_threshold: 0.5
  }
  checkpoint { every_iterations: 10 keep: 3 }
  eval { every_steps: 50000 episodes: 5 final_episodes: 20 seed: 0 }
)";

}  // namespace

absl::StatusOr<v1::RunConfig> DefaultRunConfig(absl::string_view agent) {
  CRAFTFLEET_ASSIGN_OR_RETURN(v1::RunConfig preset, AgentPreset(agent));
  preset.clear_network();
  v1::RunConfig config;
  CRAFTFLEET_CHECK(google::protobuf::TextFormat::ParseFromString(kPaperConfig, &config));
  config.MergeFrom(preset);
  config.set_agent(std::string(agent));
  return config;
}

v1::RunConfig DefaultRunConfig() { return DefaultRunConfig(kDefaultAgent).value(); }

absl::StatusOr<v1::RunConfig> ParseRunConfig(absl::string_view text, absl::string_view filename) {
  v1::RunConfig config;
  CRAFTFLEET_RETURN_IF_ERROR(ParseTextFormat(text, filename, &config));
  return config;
}

absl::StatusOr<v1::RunConfig> ResolveRunConfig(v1::RunConfig config) {
  CRAFTFLEET_ASSIGN_OR_RETURN(v1::RunConfig defaults,
                              DefaultRunConfig(config.has_agent() ? config.agent() : kDefaultAgent));
  const bool given_fragment_steps = config.has_fragment_steps();
  defaults.MergeFrom(config);
  config = std::move(defaults);
  // So that a run with them equals one without.
  if (config.precision() == v1::RunConfig::FP32) config.clear_precision();
  if (!config.acting_stream()) config.clear_acting_stream();
  if (config.overlap() == 0) config.clear_overlap();
  if (config.max_staleness() == 0) config.clear_max_staleness();
  if (config.device() == v1::RunConfig::CPU) config.clear_device();
  CRAFTFLEET_ASSIGN_OR_RETURN(const v1::NetworkConfig network, ResolveNetwork(config));
  const int32_t lane_steps = config.lanes() > 0 ? config.ppo().rollout_steps() / config.lanes() : 0;
  // The agent's own fits the agent's lanes; others were given.
  if (!given_fragment_steps && config.fragment_steps() > 0 && lane_steps % config.fragment_steps() != 0) {
    config.clear_fragment_steps();
  }
  if (!config.has_fragment_steps() && lane_steps > 0) {
    int32_t fragment_steps =
        std::min(lane_steps, network.recurrent() ? kMaxDerivedRecurrentFragmentSteps : kMaxDerivedFragmentSteps);
    while (lane_steps % fragment_steps != 0) --fragment_steps;
    config.set_fragment_steps(fragment_steps);
  }
  CRAFTFLEET_RETURN_IF_ERROR(ValidateRunConfig(config));
  return config;
}

std::string Differences(const v1::RunConfig& first, const v1::RunConfig& second) {
  google::protobuf::util::MessageDifferencer differencer;
  std::string differences;
  differencer.ReportDifferencesToString(&differences);
  differencer.Compare(first, second);
  return absl::StrJoin(absl::StrSplit(differences, '\n', absl::SkipEmpty()), "; ");
}

absl::Status ValidateRunConfig(const v1::RunConfig& config) {
  CRAFTFLEET_RETURN_IF_ERROR(CheckRanges(config));
  return CheckRelations(config);
}

std::string FormatRunConfig(const v1::RunConfig& config) {
  std::string text;
  google::protobuf::TextFormat::PrintToString(config, &text);
  return text;
}

}  // namespace craftfleet
