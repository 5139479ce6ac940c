// Flags that several programs or commands have. Each names those that it has, and may explain them in its own words
// (help.h): their declarations here say what they have in common.

#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include <absl/flags/declare.h>
#include <absl/status/statusor.h>

#include "common/process/flag_values.h"

// Processes.
ABSL_DECLARE_FLAG(std::string, address);
ABSL_DECLARE_FLAG(std::string, device);
ABSL_DECLARE_FLAG(craftfleet::TimeSpan, env_timeout);
ABSL_DECLARE_FLAG(craftfleet::TimeSpan, interval);
ABSL_DECLARE_FLAG(bool, json);
ABSL_DECLARE_FLAG(craftfleet::GivenAddress, learner);
ABSL_DECLARE_FLAG(craftfleet::GivenAddress, listen);
ABSL_DECLARE_FLAG(int32_t, threads);

// Runs and games.
ABSL_DECLARE_FLAG(std::string, attention);
ABSL_DECLARE_FLAG(std::string, checkpoint);
ABSL_DECLARE_FLAG(bool, deterministic);
ABSL_DECLARE_FLAG(std::optional<std::string>, env);
ABSL_DECLARE_FLAG(int64_t, episode);
ABSL_DECLARE_FLAG(std::string, logdir);
ABSL_DECLARE_FLAG(std::optional<uint64_t>, seed);
ABSL_DECLARE_FLAG(std::optional<int32_t>, size);
ABSL_DECLARE_FLAG(bool, terminal);
ABSL_DECLARE_FLAG(std::string, textures);
ABSL_DECLARE_FLAG(std::string, video);

namespace craftfleet {

// Where the learner listens by default.
inline constexpr char kLearnerAddress[] = "127.0.0.1:50051";

// --seed of an environment, or `otherwise` without the flag.   InvalidArgument: it does not fit into 63 bits.
absl::StatusOr<int64_t> EnvSeedFromFlag(int64_t otherwise = 0);

}  // namespace craftfleet
