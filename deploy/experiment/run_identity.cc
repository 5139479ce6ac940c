#include "deploy/experiment/run_identity.h"

#include <absl/strings/str_cat.h>

#include "common/agent_presets.h"
#include "common/config.h"
#include "common/env_name.h"

namespace craftfleet {
namespace {

// The name as it is where it can't be read: what is wrong with it comes out when it is run.
std::string CanonicalEnv(const std::string& name) {
  const absl::StatusOr<EnvName> parsed = EnvName::Parse(name);
  return parsed.ok() ? parsed->ToString() : name;
}

absl::Status CheckEnv(const char* field, const std::string& name) {
  const absl::Status status = EnvName::Parse(name).status();
  return status.ok() ? status : absl::InvalidArgumentError(absl::StrCat(field, ": ", status.message()));
}

const std::string& EvalEnv(const v1::RunConfig& config) {
  return config.eval().env().empty() ? config.env().name() : config.eval().env();
}

}  // namespace

absl::Status CheckEnvs(const v1::RunConfig& config) {
  absl::Status status = CheckEnv("env.name", config.env().name());
  status.Update(CheckEnv("eval.env", EvalEnv(config)));
  return status;
}

std::string RunIdentity(const v1::RunConfig& config) {
  v1::RunConfig shaping = config;
  shaping.clear_seed();
  shaping.clear_checkpoint();
  shaping.clear_tile();
  shaping.clear_gradient_shards();
  shaping.clear_cpu();  // the last bits
  // Whole, so that it does not matter whether a value was given or came with the agent.
  *shaping.mutable_network() = ResolveNetwork(config).value_or(config.network());
  shaping.clear_eval();
  shaping.mutable_eval()->set_env(CanonicalEnv(EvalEnv(config)));
  shaping.mutable_env()->set_name(CanonicalEnv(config.env().name()));
  shaping.mutable_env()->clear_frame_size();  // the agent's, and filled in only when it runs
  return FormatRunConfig(shaping);
}

}  // namespace craftfleet
