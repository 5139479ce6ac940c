// craftfleet eval: scores a checkpoint.

#include <unistd.h>

#include <algorithm>
#include <cstdio>

#include <absl/flags/flag.h>
#include <absl/strings/str_format.h>
#include <nlohmann/json.hpp>

#include "actor/evaluator.h"
#include "common/agent/agent_spec.h"
#include "common/agent/torch_setup.h"
#include "common/files.h"
#include "common/paths.h"
#include "common/program.h"
#include "common/status_macros.h"
#include "common/wire/protocol.h"
#include "common/wire/server.h"
#include "envserver/env_service.h"
#include "learner/run/checkpoint.h"
#include "learner/run/checkpoint_store.h"
#include "learner/run/score.h"

ABSL_FLAG(std::string, checkpoint, "",
          "a run's folder, which stands for its newest checkpoint, or a checkpoint's (needed)");
ABSL_FLAG(int32_t, episodes, 20, "episodes to play, 1..10000");
ABSL_FLAG(std::string, env, "", "what to play, such as crafter:inventory=off [what it was trained on]");
ABSL_FLAG(int64_t, seed, 0, "seed of the environment; episodes 1, 2, ... of it are played");
ABSL_FLAG(bool, deterministic, false, "take the likeliest action each time instead of drawing one");
ABSL_FLAG(std::string, json, "", "also write the result to this file as JSON");
ABSL_FLAG(std::string, textures, "", "folder with Crafter's textures as PNG [the ones that come with this program]");

namespace craftfleet {
namespace {

constexpr char kProgram[] = "craftfleet eval";
constexpr char kUsage[] =
    R"(craftfleet eval plays whole episodes with a checkpoint's policy and prints how often it unlocks each achievement, its reward,
episode length and Crafter score. The result depends on the weights, the environment and the seed alone.

  craftfleet eval --checkpoint=runs/first --episodes=100
  craftfleet eval --checkpoint=runs/first/checkpoints/iter-00000010 --env=crafter:numbers=easy-x2 --deterministic --json=eval.json)";

// Environment server and session for the games of an evaluation.
struct Games {
  std::unique_ptr<EnvServiceImpl> service;
  std::unique_ptr<wire::Server> server;
  std::unique_ptr<EnvClient> client;
};

absl::StatusOr<Games> OpenGames(const v1::EnvConfig& env, const AgentSpec& spec) {
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string textures, TextureDir(absl::GetFlag(FLAGS_textures)));
  Games games;
  CRAFTFLEET_ASSIGN_OR_RETURN(games.service, EnvServiceImpl::Create(textures));
  CRAFTFLEET_ASSIGN_OR_RETURN(games.server, wire::Server::Create({}, {games.service.get()}));
  v1::SessionHello hello;
  hello.set_protocol_version(wire::kProtocolVersion);
  *hello.mutable_env() = env;
  games.client = std::make_unique<EnvClient>(games.server->InProcess(), hello, static_cast<int>(spec.frame_bytes()));
  CRAFTFLEET_RETURN_IF_ERROR(games.client->Connect(absl::Seconds(5)));
  return games;
}

void PrintProgress(int finished, int episodes) {
  if (isatty(STDERR_FILENO) == 1)
    absl::FPrintF(stderr, "\r%d/%d episodes%s", finished, episodes, finished == episodes ? "\n" : "");
}

void PrintResult(const ScoreBoard& board) {
  const AchievementPercentages percentages = board.SuccessPercentages();
  for (int i = 0; i < kNumAchievements; ++i) absl::PrintF("%-20s %5.1f%%\n", kAchievementNames[i], percentages[i]);
  absl::PrintF("\nepisodes %d   reward %.2f   length %.1f   achievements unlocked %d/22   Crafter score %.2f\n",
               board.episodes(), board.MeanReward(), board.MeanLength(), board.Unlocked(), board.Score());
}

absl::Status WriteJson(const std::string& path, const v1::CheckpointState& state, const std::string& env,
                       const ScoreBoard& board) {
  nlohmann::ordered_json json = {{"run_id", state.run_id()},
                                 {"agent", state.config().agent()},
                                 {"env", env},
                                 {"env_steps_trained", state.env_steps()},
                                 {"seed", absl::GetFlag(FLAGS_seed)},
                                 {"deterministic", absl::GetFlag(FLAGS_deterministic)},
                                 {"episodes", board.episodes()},
                                 {"reward", board.MeanReward()},
                                 {"length", board.MeanLength()},
                                 {"score", board.Score()}};
  const AchievementPercentages percentages = board.SuccessPercentages();
  for (int i = 0; i < kNumAchievements; ++i) {
    json["success_percentages"][std::string(kAchievementNames[i])] = percentages[i];
  }
  return ReplaceFile(path, json.dump(2) + "\n");
}

absl::Status Run() {
  SetUpTorchProcess();
  if (absl::GetFlag(FLAGS_checkpoint).empty()) {
    return absl::InvalidArgumentError("--checkpoint is missing: a run's folder or a checkpoint's");
  }
  EvaluationOptions options;
  options.seed = absl::GetFlag(FLAGS_seed);
  options.episodes = absl::GetFlag(FLAGS_episodes);
  options.greedy = absl::GetFlag(FLAGS_deterministic);
  CRAFTFLEET_RETURN_IF_ERROR(options.Validate());

  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string folder, FindCheckpoint(absl::GetFlag(FLAGS_checkpoint)));
  CRAFTFLEET_ASSIGN_OR_RETURN(const Checkpoint checkpoint, LoadCheckpoint(folder, ""));
  const v1::RunConfig& config = checkpoint.state.config();
  CRAFTFLEET_ASSIGN_OR_RETURN(const AgentSpec spec, MakeAgentSpec(config));
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::unique_ptr<const Policy> policy,
                              Policy::Create(spec, checkpoint.weights, config.tile()));
  v1::EnvConfig env = config.env();
  if (!absl::GetFlag(FLAGS_env).empty()) env.set_name(absl::GetFlag(FLAGS_env));
  CRAFTFLEET_ASSIGN_OR_RETURN(const Games games, OpenGames(env, spec));

  absl::PrintF("%s, %s after %d steps, on %s\n", folder, config.agent(), checkpoint.state.env_steps(), env.name());
  CRAFTFLEET_ASSIGN_OR_RETURN(
      const std::vector<Episode> episodes,
      Evaluate(options, *policy, games.client.get(), [&](int finished) { PrintProgress(finished, options.episodes); }));
  ScoreBoard board;
  for (const Episode& episode : episodes) board.Add(episode);
  PrintResult(board);
  if (absl::GetFlag(FLAGS_json).empty()) return absl::OkStatus();
  return WriteJson(absl::GetFlag(FLAGS_json), checkpoint.state, env.name(), board);
}

}  // namespace
}  // namespace craftfleet

int main(int argc, char** argv) {
  craftfleet::ParseFlags(craftfleet::kProgram, craftfleet::kUsage, argc, argv);
  return craftfleet::ExitCode(craftfleet::kProgram, craftfleet::Run());
}
