#include "common/config.h"

#include <algorithm>
#include <cstdint>
#include <limits>

#include <absl/strings/str_cat.h>
#include <absl/strings/string_view.h>
#include <google/protobuf/text_format.h>

#include "common/status_macros.h"
#include "common/text_format.h"

namespace craftfleet {
namespace {

constexpr int32_t kMaxDerivedFragmentSteps = 256;

// Collects the first value that is out of range.
class RangeCheck {
 public:
  // NaN is never within.
  template <typename T>
  void Within(absl::string_view field, T value, T low, T high) {
    if (!(value >= low && value <= high)) Fail(absl::StrCat(field, " is ", value, ", want ", low, "..", high));
  }
  void Positive(absl::string_view field, double value, double high) {
    if (!(value > 0 && value <= high)) Fail(absl::StrCat(field, " is ", value, ", want more than 0, at most ", high));
  }
  void Named(absl::string_view field, absl::string_view value) {
    if (value.empty()) Fail(absl::StrCat(field, " is empty, want a name"));
  }
  void Multiple(absl::string_view field, int64_t value, absl::string_view of, int64_t divisor) {
    if (value % divisor != 0) Fail(absl::StrCat(field, " is ", value, ", want a multiple of ", of, " (", divisor, ")"));
  }
  const absl::Status& status() const { return status_; }

 private:
  void Fail(const std::string& message) {
    if (status_.ok()) status_ = absl::InvalidArgumentError(message);
  }
  absl::Status status_;
};

absl::Status CheckRanges(const v1::RunConfig& config) {
  RangeCheck check;
  check.Named("agent", config.agent());
  check.Named("env.name", config.env().name());
  // Nine rows of tiles need at least a pixel each; 0 stands for the agent's own size.
  if (config.env().frame_size() != 0) check.Within("env.frame_size", config.env().frame_size(), 9, 1024);
  check.Within("env.length", config.env().length(), 0, std::numeric_limits<int32_t>::max());
  check.Within("steps", config.steps(), int64_t{1}, int64_t{1'000'000'000'000});
  check.Within("lanes", config.lanes(), 1, 4096);
  check.Within("fragment_steps", config.fragment_steps(), 1, 16384);
  check.Within("tile", config.tile(), 1, 256);
  check.Within("gradient_shards", config.gradient_shards(), 1, 256);
  const v1::PpoConfig& ppo = config.ppo();
  check.Within("ppo.rollout_steps", ppo.rollout_steps(), 1, 1 << 24);
  check.Within("ppo.minibatch_size", ppo.minibatch_size(), 1, 1 << 20);
  check.Within("ppo.epochs", ppo.epochs(), 1, 1000);
  check.Within("ppo.learning_rate", ppo.learning_rate(), 0.0, 1.0);
  check.Within("ppo.gamma", ppo.gamma(), 0.0, 1.0);
  check.Within("ppo.gae_lambda", ppo.gae_lambda(), 0.0, 1.0);
  check.Positive("ppo.clip", ppo.clip(), 10);
  check.Within("ppo.value_coefficient", ppo.value_coefficient(), 0.0, 100.0);
  check.Within("ppo.entropy_coefficient", ppo.entropy_coefficient(), 0.0, 100.0);
  check.Positive("ppo.max_gradient_norm", ppo.max_gradient_norm(), 1e6);
  check.Positive("ppo.adam_epsilon", ppo.adam_epsilon(), 1);
  check.Within("checkpoint.every_iterations", config.checkpoint().every_iterations(), 1, 1'000'000);
  check.Within("checkpoint.keep", config.checkpoint().keep(), 1, 1000);
  return check.status();
}

// Needs values within their ranges.
absl::Status CheckRelations(const v1::RunConfig& config) {
  RangeCheck check;
  const v1::PpoConfig& ppo = config.ppo();
  check.Multiple("ppo.rollout_steps", ppo.rollout_steps(), "lanes", config.lanes());
  check.Multiple("ppo.rollout_steps", ppo.rollout_steps(), "lanes * fragment_steps",
                 int64_t{config.lanes()} * config.fragment_steps());
  check.Multiple("ppo.rollout_steps", ppo.rollout_steps(), "ppo.minibatch_size", ppo.minibatch_size());
  check.Multiple("ppo.minibatch_size", ppo.minibatch_size(), "gradient_shards", config.gradient_shards());
  return check.status();
}

}  // namespace

v1::RunConfig DefaultRunConfig() {
  v1::RunConfig config;
  config.set_agent("ppo_cnn");
  config.mutable_env()->set_name("crafter");
  config.mutable_env()->set_frame_size(0);
  config.mutable_env()->set_length(0);
  config.set_steps(1'000'000);
  config.set_seed(0);
  config.set_lanes(16);
  config.set_tile(8);
  config.set_gradient_shards(2);
  v1::PpoConfig& ppo = *config.mutable_ppo();
  ppo.set_rollout_steps(4096);
  ppo.set_minibatch_size(128);
  ppo.set_epochs(4);
  ppo.set_learning_rate(3e-4);
  ppo.set_gamma(0.95);
  ppo.set_gae_lambda(0.65);
  ppo.set_clip(0.2);
  ppo.set_value_coefficient(0.5);
  ppo.set_entropy_coefficient(0);
  ppo.set_max_gradient_norm(0.5);
  ppo.set_adam_epsilon(1e-5);
  ppo.set_truncation_is_terminal(false);
  config.mutable_checkpoint()->set_every_iterations(10);
  config.mutable_checkpoint()->set_keep(3);
  return config;
}

absl::StatusOr<v1::RunConfig> ParseRunConfig(absl::string_view text, absl::string_view filename) {
  v1::RunConfig given;
  CRAFTFLEET_RETURN_IF_ERROR(ParseTextFormat(text, filename, &given));
  v1::RunConfig config = DefaultRunConfig();
  config.MergeFrom(given);
  return config;
}

absl::StatusOr<v1::RunConfig> ResolveRunConfig(v1::RunConfig config) {
  const int32_t lane_steps = config.lanes() > 0 ? config.ppo().rollout_steps() / config.lanes() : 0;
  if (!config.has_fragment_steps() && lane_steps > 0) {
    int32_t fragment_steps = std::min(lane_steps, kMaxDerivedFragmentSteps);
    while (lane_steps % fragment_steps != 0) --fragment_steps;
    config.set_fragment_steps(fragment_steps);
  }
  CRAFTFLEET_RETURN_IF_ERROR(ValidateRunConfig(config));
  return config;
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
