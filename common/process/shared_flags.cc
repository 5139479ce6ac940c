#include "common/process/shared_flags.h"

#include <limits>

#include <absl/flags/flag.h>
#include <absl/time/time.h>

#include "common/base/status_macros.h"
#include "common/process/flag_values.h"

ABSL_FLAG(std::string, address, craftfleet::kLearnerAddress, "address of the learner, HOST:PORT");
ABSL_FLAG(std::string, device, "auto",
          "device that computes: auto (a GPU if there is one), cpu, cuda or cuda:N\n"
          "craftfleet train acts there too. A GPU requires a build with a CUDA LibTorch. A run stays on its type of "
          "device");
ABSL_FLAG(craftfleet::TimeSpan, env_timeout, {absl::Seconds(10)},
          "time limit of a request for game steps, 0.1s..1h; a step takes microseconds\n"
          "after that the request is abandoned, and the games continue from their snapshots");
ABSL_FLAG(craftfleet::TimeSpan, interval, {absl::Seconds(1)},
          "time between updates, 100ms..1m; a plain number is in seconds");
ABSL_FLAG(bool, json, false, "print JSON");
ABSL_FLAG(craftfleet::GivenAddress, learner, {}, "address of the learner, HOST:PORT");
ABSL_FLAG(craftfleet::GivenAddress, listen, {}, "address to listen on, HOST:PORT; port 0: any free one");
ABSL_FLAG(int32_t, threads, 0, "threads that compute; 0: as many as the CPU quota allows");

ABSL_FLAG(std::string, attention, "off",
          "show the attention of agents such as oc_sa and oc_ca: mean, sum, a number, or off\n"
          "mean or sum over the heads (oc_sa) or slots (oc_ca), or the number of one of them, from 0");
ABSL_FLAG(std::string, checkpoint, "",
          "folder of a run, for its newest checkpoint, of one checkpoint, or of results with weights (required)");
ABSL_FLAG(bool, deterministic, false, "always take the most likely action instead of sampling one");
ABSL_FLAG(std::optional<std::string>, env, std::nullopt,
          "environment to play, such as crafter:inventory=off [the one of the training]");
ABSL_FLAG(int64_t, episode, 1, "episode of the environment to begin with, 1..1000000000");
ABSL_FLAG(std::string, logdir, "", "folder of the run: configuration, logs, curves, checkpoints (required)");
ABSL_FLAG(std::optional<uint64_t>, seed, std::nullopt, "seed of the environment [0]");
ABSL_FLAG(std::optional<int32_t>, size, std::nullopt, "width and height of pictures in pixels, 64..1024");
ABSL_FLAG(bool, terminal, false,
          "show the game in the terminal, also over ssh, instead of a window, in the colours that it has");
ABSL_FLAG(std::string, textures, "",
          "folder with Crafter's textures as PNG, such as crafter/assets of the Python package [the built-in ones]");
ABSL_FLAG(std::string, video, "", "where to write videos, MP4");

namespace craftfleet {

absl::StatusOr<int64_t> EnvSeedFromFlag(int64_t otherwise) {
  const std::optional<uint64_t> seed = absl::GetFlag(FLAGS_seed);
  if (!seed.has_value()) return otherwise;
  constexpr uint64_t kMost = std::numeric_limits<int64_t>::max();
  CRAFTFLEET_RETURN_IF_ERROR(CheckFlagRange<uint64_t>("seed", *seed, 0, kMost));
  return static_cast<int64_t>(*seed);
}

}  // namespace craftfleet
