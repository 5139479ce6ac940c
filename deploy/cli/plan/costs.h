// What a step of a run costs on one machine, as measured, and the file that keeps it.

#ifndef CRAFTFLEET_DEPLOY_CLI_PLAN_COSTS_H_
#define CRAFTFLEET_DEPLOY_CLI_PLAN_COSTS_H_

#include <array>
#include <cstddef>
#include <optional>
#include <string>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>

#include "common/base/frame_format.h"
#include "common/base/types.h"
#include "craftfleet/v1/config.pb.h"

namespace craftfleet {

// What a step costs because of its frame: between environment server and actor, and from there to the learner.
struct FrameCosts {
  double server_us = 0;   // CPU time of the environment server, with the game
  double game_us = 0;     // of that, between a request and its reply
  double actor_us = 0;    // CPU time of the actor: receiving the step, drawing its frame, sending it to the learner
  double learner_us = 0;  // CPU time of the learner: receiving the step and drawing its frame
  double bytes = 0;       // that the learner receives
};

// Microseconds are those of one CPU core, a step and, for updates, an epoch.
struct Costs {
  // What they are the costs of. `config` is CostlyFields.
  std::string cpu;       // CpuDescription
  std::string build;     // BuildId
  std::string config;    // CostlyFields
  std::string measured;  // when, for people

  double update_us = 0;                 // of a sample, with one thread
  std::optional<double> two_thread_us;  // the same elapsed, with two threads; absent: minibatches can't be halved
  std::optional<double> gpu_update_us;  // elapsed on one GPU; absent: not measured
  double act_us = 0;                    // of a frame in a full tile
  std::array<FrameCosts, kFrameFormats.size()> frames;  // by FrameFormat
  double weight_bytes = 0;

  const FrameCosts& operator[](FrameFormat format) const { return frames[static_cast<size_t>(format)]; }
  FrameCosts& operator[](FrameFormat format) { return frames[static_cast<size_t>(format)]; }
};

// The fields of a complete configuration on which costs depend, as text of one line: agent and network, environment,
// tile, shards, minibatches.
std::string CostlyFields(const v1::RunConfig& config);

// As JSON.
std::string FormatCosts(const Costs& costs);
//   InvalidArgument: no such JSON, or a number that no cost can be; names `path` and the field.
absl::StatusOr<Costs> ParseCosts(absl::string_view text, absl::string_view path);

// Writes FormatCosts to `path`, in a folder that is created if need be.   Errors as ReplaceFile.
absl::Status KeepCosts(const Costs& costs, const std::string& path);

// Where the costs of `agent` are kept unless a file is given: in $XDG_CACHE_HOME or ~/.cache.
//   FailedPrecondition: neither variable is set.
absl::StatusOr<std::string> DefaultCostsPath(absl::string_view agent);

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_CLI_PLAN_COSTS_H_
