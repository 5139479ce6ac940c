#include "deploy/cli/inspect/run_identity.h"

#include <absl/strings/str_cat.h>

#include "common/config/agent_presets.h"
#include "common/config/config.h"
#include "common/config/env_name.h"
#include "common/config/known_canary.h"

namespace craftfleet {
namespace {

// A name that can't be parsed is kept: the run reports its error.
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

v1::RunConfig ShapingConfig(const v1::RunConfig& config) {
  v1::RunConfig shaping = config;
  shaping.clear_seed();
  shaping.clear_checkpoint();
  shaping.clear_tile();
  shaping.clear_gradient_shards();
  shaping.clear_cpu();     // changes only the last bits of numbers
  shaping.clear_device();  // likewise
  // Resolved, so that values given explicitly and values of the agent compare equal.
  *shaping.mutable_network() = ResolveNetwork(config).value_or(config.network());
  shaping.clear_eval();
  shaping.mutable_eval()->set_env(CanonicalEnv(EvalEnv(config)));
  shaping.mutable_env()->set_name(CanonicalEnv(config.env().name()));
  shaping.mutable_env()->clear_frame_size();  // the agent determines it when the run starts
  return shaping;
}

std::string RunIdentity(const v1::RunConfig& config, absl::string_view texture_digest) {
  const bool built_in = texture_digest.empty() || texture_digest == kBuiltInTextures;
  return absl::StrCat(FormatRunConfig(ShapingConfig(config)),
                      built_in ? "" : absl::StrCat("# textures ", texture_digest, "\n"));
}

}  // namespace craftfleet
