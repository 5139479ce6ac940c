// craftfleet policy: the actions of a checkpoint's policy for observations on standard input.

#include <algorithm>
#include <cstdint>
#include <cstdio>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <absl/flags/flag.h>
#include <absl/strings/str_format.h>
#include <nlohmann/json.hpp>

#include "common/base/crafter.h"
#include "common/base/keyed_random.h"
#include "common/base/status_macros.h"
#include "common/process/program.h"
#include "common/process/shared_flags.h"
#include "deploy/cli/checkpoint_policy.h"
#include "deploy/cli/command.h"

namespace craftfleet {
namespace {

constexpr char kProgram[] = "craftfleet policy";
constexpr char kUsage[] =
    R"(craftfleet policy chooses actions for the observations on its standard input. The Python package runs it.

First it prints a line of JSON: agent, env, env_steps (of training), frame_size (pixels) and has_memory (whether rewards matter).
A request is, in little-endian: uint32 n, the number of games, the same in all requests; uint8[n], 1 where an episode begins;
float32[n], the rewards of the steps that led here; uint8[n,H,W,3], the observations. The answer is uint8[n], the actions. Game i
(from 0) plays the episodes i+1, n+i+1, ...; their actions are those of craftfleet eval with the same seed. It ends with its input.

  craftfleet policy --checkpoint=runs/first)";

constexpr uint32_t kMaxGames = 4096;

struct Request {
  std::string starts;          // [n]: 1 where an episode begins
  std::vector<float> rewards;  // [n]
  std::string frames;          // uint8[n,H,W,3]
};

bool Read(void* data, size_t size) { return std::fread(data, 1, size, stdin) == size; }

// Reads the next request. Returns false at the end of the input.   InvalidArgument: it ends within a request, or n is
// out of range.   DataLoss: it can't be read.
absl::StatusOr<bool> ReadRequest(int64_t frame_bytes, Request* request) {
  uint32_t games = 0;
  const size_t size = std::fread(&games, 1, sizeof(games), stdin);
  if (size == sizeof(games)) {
    if (games < 1 || games > kMaxGames) {
      return absl::InvalidArgumentError(absl::StrFormat("%d games in a request, want 1..%d", games, kMaxGames));
    }
    request->starts.resize(games);
    request->rewards.resize(games);
    request->frames.resize(games * frame_bytes);
    if (Read(request->starts.data(), games) && Read(request->rewards.data(), games * sizeof(float)) &&
        Read(request->frames.data(), request->frames.size())) {
      return true;
    }
  }
  CRAFTFLEET_RETURN_IF_ERROR(CheckStandardInput());
  if (size == 0) return false;
  return absl::InvalidArgumentError("the input ends within a request");
}

// The episodes that are played side by side, and the agent's state in each. Thread-compatible.
class Players {
 public:
  Players(CheckpointPolicy agent, int64_t seed, bool greedy) : agent_(std::move(agent)), seed_(seed), greedy_(greedy) {}

  // The action of each game as a byte.   InvalidArgument: another number of games than before.   Others as Policy::Act.
  absl::StatusOr<std::string> Act(const Request& request) {
    const Policy& policy = *agent_.policy;
    const size_t games = request.starts.size();
    if (before_.empty()) Begin(games);
    if (steps_.size() != games) {
      return absl::InvalidArgumentError(absl::StrFormat("%d games in a request after %d", games, steps_.size()));
    }
    CRAFTFLEET_RETURN_IF_ERROR(StartOrRemember(request));
    std::vector<double> noise;
    for (size_t i = 0; i < games; ++i) {
      if (!greedy_) noise.push_back(ActionNoise(static_cast<uint64_t>(seed_), lanes_[i], steps_[i]));
      ++steps_[i];
    }
    CRAFTFLEET_ASSIGN_OR_RETURN(const ActResult act,
                                policy.Act(request.frames, lanes_, noise, absl::MakeSpan(states_)));
    before_ = request.frames;
    std::string actions;
    for (const Action action : act.actions) actions.push_back(static_cast<char>(action));
    return actions;
  }

 private:
  void Begin(size_t games) {
    for (size_t i = 0; i < games; ++i) lanes_.push_back(static_cast<int>(i + 1));
    steps_.assign(games, 0);
    states_.assign(games * agent_.policy->state_size(), 0);
  }

  // Makes ready for the next episode where one begins, and has the agent remember achievements elsewhere.
  absl::Status StartOrRemember(const Request& request) {
    const size_t size = agent_.policy->state_size();
    const size_t frame_bytes = agent_.spec.frame_bytes();
    for (size_t i = 0; i < lanes_.size(); ++i) {
      const absl::Span<float> state = absl::MakeSpan(states_).subspan(i * size, size);
      if (request.starts[i] != 0) {
        if (steps_[i] > 0) lanes_[i] += static_cast<int>(lanes_.size());
        steps_[i] = 0;
        std::fill(state.begin(), state.end(), 0.0F);
      } else if (agent_.policy->has_memory() && steps_[i] > 0 && UnlocksAchievement(request.rewards[i])) {
        const absl::string_view before = absl::string_view(before_).substr(i * frame_bytes, frame_bytes);
        const absl::string_view after = absl::string_view(request.frames).substr(i * frame_bytes, frame_bytes);
        CRAFTFLEET_RETURN_IF_ERROR(agent_.policy->Remember(before, after, {lanes_[i]}, state));
      }
    }
    return absl::OkStatus();
  }

  const CheckpointPolicy agent_;
  const int64_t seed_;
  const bool greedy_;
  std::vector<int> lanes_;      // [n]: the episodes, from 1
  std::vector<int64_t> steps_;  // [n]: played in them
  std::vector<float> states_;   // [n,state_size]
  std::string before_;          // the observations before; empty: none yet
};

absl::Status Run() {
  if (absl::GetFlag(FLAGS_checkpoint).empty()) {
    return absl::InvalidArgumentError("--checkpoint is missing: the folder of a run or of a checkpoint");
  }
  CRAFTFLEET_ASSIGN_OR_RETURN(const int64_t seed, EnvSeedFromFlag());
  CRAFTFLEET_ASSIGN_OR_RETURN(CheckpointPolicy agent, LoadPolicy(absl::GetFlag(FLAGS_checkpoint)));
  const int64_t frame_bytes = agent.spec.frame_bytes();
  const nlohmann::ordered_json description = {{"agent", agent.spec.name},
                                              {"env", agent.state.config().env().name()},
                                              {"env_steps", agent.state.env_steps()},
                                              {"frame_size", agent.spec.frame_size},
                                              {"has_memory", agent.policy->has_memory()}};
  absl::PrintF("%s\n", description.dump());
  CRAFTFLEET_RETURN_IF_ERROR(FinishStandardOutput());
  Players players(std::move(agent), seed, absl::GetFlag(FLAGS_deterministic));
  Request request;
  while (true) {
    CRAFTFLEET_ASSIGN_OR_RETURN(const bool more, ReadRequest(frame_bytes, &request));
    if (!more) return absl::OkStatus();
    CRAFTFLEET_ASSIGN_OR_RETURN(const std::string actions, players.Act(request));
    std::fwrite(actions.data(), 1, actions.size(), stdout);
    CRAFTFLEET_RETURN_IF_ERROR(FinishStandardOutput());
  }
}

int RunPolicy(int argc, char** argv) {
  ParseFlags({kProgram, kUsage, {"checkpoint", "seed", "deterministic"}, {}, {{"seed", "seed of sampled actions [0]"}}},
             argc, argv);
  return ExitCode(kProgram, Run());
}

const RegisterCommand kRegistered("policy", &RunPolicy);

}  // namespace
}  // namespace craftfleet
