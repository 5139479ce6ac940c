// Which runs are of the same configuration, whatever their seeds.

#ifndef CRAFTFLEET_DEPLOY_EXPERIMENT_RUN_IDENTITY_H_
#define CRAFTFLEET_DEPLOY_EXPERIMENT_RUN_IDENTITY_H_

#include <string>

#include <absl/status/status.h>

#include "craftfleet/v1/config.pb.h"

namespace craftfleet {

// InvalidArgument: an environment that EnvName::Parse refuses, of training or evaluation.
absl::Status CheckEnvs(const v1::RunConfig& config);

// Equal for two complete configurations when their runs may be averaged: all that shapes learning or what is measured
// counts; the seed, checkpoints, how often it is evaluated, and how the computing is done (tile, gradient shards, cpu)
// do not. Environments count by their canonical names.
std::string RunIdentity(const v1::RunConfig& config);

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_EXPERIMENT_RUN_IDENTITY_H_
