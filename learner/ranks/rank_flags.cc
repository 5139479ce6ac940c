#include "learner/ranks/rank_flags.h"

#include <cstdint>
#include <cstdlib>
#include <initializer_list>
#include <optional>
#include <string>

#include <absl/flags/flag.h>
#include <absl/strings/numbers.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>

#include "common/base/status_macros.h"
#include "common/process/flag_values.h"

ABSL_FLAG(std::optional<int32_t>, world_size, std::nullopt,
          "learners of the run, which share out its updates (learner/ranks/README.md): at most gradient_shards\n"
          "each is started with the same flags, and its own --rank\n"
          "[WORLD_SIZE or SLURM_STEP_NUM_TASKS of the environment, or 1]");
ABSL_FLAG(std::optional<int32_t>, rank, std::nullopt,
          "number of this learner; 0 has the run, others only compute\n"
          "[RANK, SLURM_PROCID or JOB_COMPLETION_INDEX of the environment, or 0]");
ABSL_FLAG(std::optional<std::string>, master_addr, std::nullopt,
          "host on which rank 0 listens for the other ranks, at that address only\n"
          "[MASTER_ADDR of the environment, or 127.0.0.1]");
ABSL_FLAG(std::optional<int32_t>, master_port, std::nullopt,
          "port of rank 0 for the other ranks; neither encrypted nor authenticated [MASTER_PORT of the environment, or "
          "29500]");
ABSL_FLAG(craftfleet::TimeSpan, rank_timeout, {absl::Minutes(5)}, "how long ranks wait for each other at the start");

namespace craftfleet {
namespace {

constexpr int kMaxRanks = 256;  // as gradient_shards
constexpr std::initializer_list<const char*> kWorldSizeVariables = {"WORLD_SIZE", "SLURM_STEP_NUM_TASKS"};

// A number from a flag, or else from the first of `variables` that is set.
absl::StatusOr<int> Number(absl::string_view flag, const std::optional<int32_t>& given,
                           std::initializer_list<const char*> variables, int otherwise, int low, int high) {
  if (given.has_value()) {
    CRAFTFLEET_RETURN_IF_ERROR(CheckFlagRange(flag, *given, low, high));
    return *given;
  }
  for (const char* const variable : variables) {
    const char* const text = std::getenv(variable);
    if (text == nullptr) continue;
    int number = 0;
    if (absl::SimpleAtoi(text, &number) && number >= low && number <= high) return number;
    return absl::InvalidArgumentError(
        absl::StrFormat("%s=%s of the environment, want %d..%d, or give --%s", variable, text, low, high, flag));
  }
  return otherwise;
}

// What says how many ranks there are: "--world_size=2", or "WORLD_SIZE=2 of the environment".
std::string GivenWorldSize(int world_size) {
  if (!absl::GetFlag(FLAGS_world_size).has_value()) {
    for (const char* const variable : kWorldSizeVariables) {
      if (std::getenv(variable) != nullptr) return absl::StrCat(variable, "=", world_size, " of the environment");
    }
  }
  return absl::StrCat("--world_size=", world_size);
}

}  // namespace

absl::StatusOr<RankOptions> RankOptionsFromFlags() {
  RankOptions options;
  CRAFTFLEET_ASSIGN_OR_RETURN(
      options.world_size, Number("world_size", absl::GetFlag(FLAGS_world_size), kWorldSizeVariables, 1, 1, kMaxRanks));
  options.given = GivenWorldSize(options.world_size);
  if (options.world_size == 1 && !absl::GetFlag(FLAGS_rank).has_value()) return options;
  CRAFTFLEET_ASSIGN_OR_RETURN(
      options.rank, Number("rank", absl::GetFlag(FLAGS_rank), {"RANK", "SLURM_PROCID", "JOB_COMPLETION_INDEX"}, 0, 0,
                           options.world_size - 1));
  const char* const host = std::getenv("MASTER_ADDR");
  options.master_addr = absl::GetFlag(FLAGS_master_addr).value_or(host != nullptr ? host : options.master_addr);
  CRAFTFLEET_ASSIGN_OR_RETURN(options.master_port, Number("master_port", absl::GetFlag(FLAGS_master_port),
                                                          {"MASTER_PORT"}, options.master_port, 1, 65535));
  options.timeout = absl::GetFlag(FLAGS_rank_timeout).value;
  CRAFTFLEET_RETURN_IF_ERROR(CheckFlagRange("rank_timeout", options.timeout, absl::Seconds(1), absl::Hours(24)));
  return options;
}

}  // namespace craftfleet
