#include "learner/runnable_config.h"

#include <unistd.h>

#include <algorithm>
#include <array>
#include <limits>
#include <string>
#include <utility>

#include <absl/strings/str_format.h>

#include "common/agent/attention_map.h"
#include "common/agent/nets/recurrent_core.h"
#include "common/base/status_macros.h"
#include "common/config/config.h"
#include "common/config/env_name.h"
#include "common/io/snapshot_envelope.h"
#include "common/process/cgroup.h"
#include "common/wire/protocol.h"

namespace craftfleet {
namespace {

// Bytes of a fragment that don't depend on its steps: a snapshot, names, numbers, lengths.
constexpr int64_t kFragmentRest = kMaxSnapshotBytes + (8 << 10);
// Bytes per step: action, end, log-probability, value, reward, value at a truncation.
constexpr int64_t kStepBytes = 1 + 1 + 4 * sizeof(float);
// Bytes per episode: 22 counts of at most 5 bytes, length, reward.
constexpr int64_t kEpisodeBytes = 150;
// Bytes of other requests: thousands of lanes, reports on environment servers, 10,000 episodes of an evaluation.
constexpr int64_t kLargestRequestBytes = 4 << 20;
constexpr double kGiB = 1 << 30;

// The number of attention probabilities per observation: the largest tensor of a network with an object module.
double AttentionProbabilities(const v1::NetworkConfig& network) {
  if (network.objects() != v1::NetworkConfig::SELF_ATTENTION &&
      network.objects() != v1::NetworkConfig::CROSS_ATTENTION) {
    return 0;
  }
  const double tokens = PatchGrid{network.frame_size(), network.patch(), network.stride()}.count();
  const bool to_each_other = network.objects() == v1::NetworkConfig::SELF_ATTENTION;
  return network.heads() * tokens * (to_each_other ? tokens : network.slots());
}

// A part of the memory that a learner needs, and the configuration field that it depends on most.
struct Need {
  double bytes;  // may exceed the range of int64_t
  const char* field;
  int64_t value;
};

// The frames of an iteration, and its recurrent states if fragments contain one per step; with overlap or
// asynchronous play also those of the next ones.
Need IterationNeed(const v1::RunConfig& config, const AgentSpec& spec, const wire::FragmentShape& shape) {
  const double states = static_cast<double>(shape.states) / shape.steps * shape.state_size * sizeof(float);
  const double step = static_cast<double>(spec.frame_bytes()) + states;
  return {(1 + config.overlap() + config.max_staleness()) * step * config.ppo().rollout_steps(), "ppo.rollout_steps",
          config.ppo().rollout_steps()};
}

// A minibatch's frames as floats, and the attention probabilities of a shard.
Need MinibatchNeed(const v1::RunConfig& config, const AgentSpec& spec) {
  const double attention = AttentionProbabilities(spec.network) / config.gradient_shards();
  const auto frame = static_cast<double>(spec.frame_bytes());
  const double bytes = config.ppo().minibatch_size() * (frame + attention) * sizeof(float);
  if (attention > frame) return {bytes, "network.stride", spec.network.stride()};
  return {bytes, "ppo.minibatch_size", config.ppo().minibatch_size()};
}

// The rollouts that are kept until the next phase of distillation.
Need DistillationNeed(const v1::RunConfig& config, const AgentSpec& spec) {
  const int32_t iterations = config.distillation().every_iterations();
  return {static_cast<double>(iterations) * config.ppo().rollout_steps() * static_cast<double>(spec.frame_bytes()),
          "distillation.every_iterations", iterations};
}

// Weights, Adam's two moments, the copies for actors and for checkpoints, and gradients.
Need WeightsNeed(const v1::RunConfig& config, const AgentSpec& spec, bool updates_on_cpu) {
  constexpr int kCopies = 1 + 2 + 1 + 1 + 2;
  constexpr int kDistillationCopies = 2 * 2 * 2;  // two more optimisers, and their state to roll back to
  const int copies = kCopies + (config.distillation().every_iterations() > 0 ? kDistillationCopies : 0);
  const int gradients = updates_on_cpu ? config.gradient_shards() : 0;
  const double bytes = static_cast<double>(spec.param_count) * sizeof(float) * (copies + gradients);
  if (gradients > copies) return {bytes, "gradient_shards", gradients};
  return {bytes, "network.frame_size", spec.network.frame_size()};
}

absl::Status CheckMemory(const v1::RunConfig& config, const AgentSpec& spec, const wire::FragmentShape& shape,
                         const LearnerMachine& machine) {
  std::array<Need, 4> needs = {IterationNeed(config, spec, shape), WeightsNeed(config, spec, machine.updates_on_cpu),
                               MinibatchNeed(config, spec), DistillationNeed(config, spec)};
  if (!machine.updates_on_cpu) needs[2].bytes = 0;
  double bytes = 0;
  for (const Need& need : needs) bytes += need.bytes;
  if (machine.memory_bytes == 0 || bytes <= static_cast<double>(machine.memory_bytes)) return absl::OkStatus();
  const Need& most =
      *std::max_element(needs.begin(), needs.end(), [](const Need& a, const Need& b) { return a.bytes < b.bytes; });
  return absl::InvalidArgumentError(absl::StrFormat(
      "%s is %d: the learner needs at least %.1f GiB of memory, %.1f GiB of it due to this field; it has %.1f GiB: "
      "want a %s value",
      most.field, most.value, bytes / kGiB, most.bytes / kGiB, static_cast<double>(machine.memory_bytes) / kGiB,
      absl::string_view(most.field) == "network.stride" ? "larger" : "smaller"));
}

absl::Status CheckMessage(const v1::RunConfig& config, const wire::FragmentShape& shape) {
  const int64_t bytes = LargestFragmentBytes(shape);
  if (bytes <= wire::kMaxMessageBytes) return absl::OkStatus();
  wire::FragmentShape fits = shape;
  const int32_t lane_steps = config.ppo().rollout_steps() / config.lanes();  // of which it must be a divisor
  while (fits.steps > 1 && (LargestFragmentBytes(fits) > wire::kMaxMessageBytes || lane_steps % fits.steps != 0)) {
    --fits.steps;
    if (shape.states > 1) fits.states = fits.steps;
  }
  return absl::InvalidArgumentError(
      absl::StrFormat("fragment_steps is %d: a fragment may have %d bytes, but a message at most %d: want at most %d",
                      config.fragment_steps(), bytes, wire::kMaxMessageBytes, fits.steps));
}

}  // namespace

absl::StatusOr<v1::RunConfig> CompleteConfig(v1::RunConfig config) {
  CRAFTFLEET_ASSIGN_OR_RETURN(config, ResolveRunConfig(std::move(config)));
  CRAFTFLEET_ASSIGN_OR_RETURN(const AgentSpec spec, MakeAgentSpec(config));
  CRAFTFLEET_ASSIGN_OR_RETURN(const EnvName env, EnvName::Parse(config.env().name()));
  config.mutable_env()->set_name(env.ToString());
  if (spec.frame_size < kMinFrameSize) {
    return absl::InvalidArgumentError(
        absl::StrFormat("network.frame_size is %d, want at least %d: environment servers draw no smaller pictures",
                        spec.frame_size, kMinFrameSize));
  }
  if (config.env().frame_size() == 0) config.mutable_env()->set_frame_size(spec.frame_size);
  if (config.env().frame_size() != spec.frame_size) {
    return absl::InvalidArgumentError(absl::StrFormat("env.frame_size: %d, want %d, the frame size of agent %s",
                                                      config.env().frame_size(), spec.frame_size, spec.name));
  }
  if (config.eval().env().empty()) config.mutable_eval()->set_env(config.env().name());
  CRAFTFLEET_ASSIGN_OR_RETURN(const EnvName eval_env, EnvName::Parse(config.eval().env()));
  config.mutable_eval()->set_env(eval_env.ToString());
  return config;
}

wire::FragmentShape FragmentShapeOf(const v1::RunConfig& config, const AgentSpec& spec) {
  wire::FragmentShape shape;
  shape.lanes = config.lanes();
  shape.steps = config.fragment_steps();
  shape.frame_bytes = static_cast<int>(spec.frame_bytes());
  shape.state_size = spec.state_size;
  shape.states = KeepsEveryState(spec, config.ppo()) ? config.fragment_steps() : 1;
  shape.hidden = spec.network.memory() ? std::numeric_limits<int>::max() : static_cast<int>(LstmLayer::kHidden);
  if (config.env().length() != 0) shape.max_length = config.env().length();
  shape.env_digest = EnvDigest(EnvName::Parse(config.env().name()).value_or(EnvName()).WorldName(), shape.max_length);
  return shape;
}

int64_t LargestFragmentBytes(const wire::FragmentShape& shape) {
  const int64_t step = shape.frame_bytes + kStepBytes + kEpisodeBytes;
  const int64_t states = int64_t{shape.states} + 1;  // one more for the state after the last step
  return step * shape.steps + states * shape.state_size * static_cast<int64_t>(sizeof(float)) + kFragmentRest;
}

int LargestMessageBytes(const wire::FragmentShape& shape) {
  return static_cast<int>(
      std::min<int64_t>(std::max(LargestFragmentBytes(shape), kLargestRequestBytes), wire::kMaxMessageBytes));
}

int64_t OwnMemoryBytes() {
  int64_t bytes = int64_t{::sysconf(_SC_PHYS_PAGES)} * ::sysconf(_SC_PAGESIZE);
  if (const auto group = OwnMemoryLimit(); group.has_value()) bytes = std::min(bytes, group->limit);
  return std::max<int64_t>(bytes, 0);
}

absl::Status CheckRunnable(const v1::RunConfig& config, const AgentSpec& spec, const LearnerMachine& machine) {
  const wire::FragmentShape shape = FragmentShapeOf(config, spec);
  CRAFTFLEET_RETURN_IF_ERROR(CheckMessage(config, shape));
  return CheckMemory(config, spec, shape, machine);
}

}  // namespace craftfleet
