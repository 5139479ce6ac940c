// Determines whether runs have the same configuration, apart from their seeds.

#ifndef CRAFTFLEET_DEPLOY_CLI_INSPECT_RUN_IDENTITY_H_
#define CRAFTFLEET_DEPLOY_CLI_INSPECT_RUN_IDENTITY_H_

#include <string>

#include <absl/status/status.h>
#include <absl/strings/string_view.h>

#include "craftfleet/v1/config.pb.h"

namespace craftfleet {

// InvalidArgument: EnvName::Parse refuses the environment of training or of evaluation.
absl::Status CheckEnvs(const v1::RunConfig& config);

// The part of a complete configuration that affects learning or the measures: without the seed, checkpoints, the
// frequency of evaluations, and technical settings (tile, gradient shards, cpu). Environments have their canonical
// names.
v1::RunConfig ShapingConfig(const v1::RunConfig& config);

// ShapingConfig as text, and the textures of the run if they are not those that come with the programs: another digest
// (common/io/texture_digest.h) is another identity. "": the built-in ones. Runs may be averaged if their identities are
// equal.
std::string RunIdentity(const v1::RunConfig& config, absl::string_view texture_digest = "");

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_CLI_INSPECT_RUN_IDENTITY_H_
