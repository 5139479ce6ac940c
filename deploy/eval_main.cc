// craftfleet eval: scores a checkpoint, and shows how it plays.

#include <unistd.h>

#include <cstdio>
#include <optional>

#include <absl/flags/flag.h>
#include <absl/strings/str_format.h>
#include <absl/time/clock.h>
#include <nlohmann/json.hpp>

#include "actor/evaluator.h"
#include "actor/recording/episode_recorder.h"
#include "common/agent/agent_spec.h"
#include "common/agent/torch_setup.h"
#include "common/cpu_pin.h"
#include "common/files.h"
#include "common/log.h"
#include "common/paths.h"
#include "common/program.h"
#include "common/status_macros.h"
#include "common/wire/protocol.h"
#include "common/wire/server.h"
#include "deploy/eval/eval_plan.h"
#include "deploy/eval/eval_result.h"
#include "envserver/env_service.h"
#include "learner/run/checkpoint.h"
#include "learner/run/checkpoint_store.h"
#include "learner/run/score.h"

ABSL_FLAG(std::string, checkpoint, "",
          "a run's folder, which stands for its newest checkpoint, or a checkpoint's (needed)");
ABSL_FLAG(std::optional<int32_t>, episodes, std::nullopt, "episodes to play, 1..10000 [20]");
ABSL_FLAG(std::optional<std::string>, env, std::nullopt,
          "what to play, such as crafter:inventory=off [what it was trained on]");
ABSL_FLAG(std::optional<int64_t>, seed, std::nullopt,
          "seed of the environment; episodes 1, 2, ... of it are played [0]");
ABSL_FLAG(bool, deterministic, false, "take the likeliest action each time instead of drawing one");
ABSL_FLAG(std::string, protocol, "",
          "final: replay the run's final evaluation, argmax episodes, then sampled ones, as its configuration says");
ABSL_FLAG(std::string, json, "", "also write the result to this file as JSON");
ABSL_FLAG(std::string, video, "", "write a video of each episode to this folder, <time>-ach<unlocked>-len<steps>.mp4");
ABSL_FLAG(std::string, episodes_npz, "",
          "write each episode to this folder as a file for numpy, in the format of Crafter's own recorder");
ABSL_FLAG(std::string, pictures, "", "write a picture of every --picture_every'th step to this folder, as PNG");
ABSL_FLAG(int32_t, picture_every, 50, "steps from one picture to the next, 1..10000");
ABSL_FLAG(int32_t, video_size, 576, "width and height of videos and pictures in pixels, an even number 64..1024");
ABSL_FLAG(std::string, attention, "off",
          "videos and pictures also show where the agent looks, for oc_sa and oc_ca and their like:\n"
          "mean or sum over its heads (oc_sa) or slots (oc_ca), the number of one of them from 0, or off");
ABSL_FLAG(std::string, textures, "", "folder with Crafter's textures as PNG [the ones that come with this program]");
ABSL_FLAG(double, env_timeout, 10, "seconds that a step of the games may take, 0.1..3600");

namespace craftfleet {
namespace {

constexpr char kProgram[] = "craftfleet eval";
constexpr char kUsage[] =
    R"(craftfleet eval plays whole episodes with a checkpoint's policy and prints how often it unlocks each achievement, its reward,
episode length and Crafter score. The result depends on the weights, the environment and the seed alone.

  craftfleet eval --checkpoint=runs/first --episodes=100
  craftfleet eval --checkpoint=runs/first/checkpoints/iter-00000010 --env=crafter:numbers=easy-x2 --deterministic --json=eval.json
  craftfleet eval --checkpoint=runs/first --protocol=final --video=videos --episodes_npz=episodes
  craftfleet eval --checkpoint=runs/oc_ca --episodes=3 --video=videos --attention=sum)";

absl::Status OutOfRange(const char* flag, int value, const char* wanted) {
  return absl::InvalidArgumentError(absl::StrFormat("--%s=%d, want %s", flag, value, wanted));
}

// What the flags ask to be recorded.
absl::StatusOr<EpisodeRecorder::Options> RecorderOptions() {
  EpisodeRecorder::Options options;
  options.video_folder = absl::GetFlag(FLAGS_video);
  options.npz_folder = absl::GetFlag(FLAGS_episodes_npz);
  options.picture_folder = absl::GetFlag(FLAGS_pictures);
  options.picture_every = absl::GetFlag(FLAGS_picture_every);
  if (options.picture_every < 1 || options.picture_every > 10000) {
    return OutOfRange("picture_every", options.picture_every, "1..10000");
  }
  const int size = absl::GetFlag(FLAGS_video_size);
  if (size < 64 || size > 1024 || size % 2 != 0) return OutOfRange("video_size", size, "an even number 64..1024");
  const bool pictures = !options.video_folder.empty() || !options.picture_folder.empty();
  if (pictures) options.picture_size = size;
  if (absl::GetFlag(FLAGS_attention) == "off") return options;
  if (!pictures) return absl::InvalidArgumentError("--attention wants --video or --pictures beside it");
  absl::StatusOr<AttentionChoice> choice = AttentionChoice::Parse(absl::GetFlag(FLAGS_attention));
  if (!choice.ok()) return absl::InvalidArgumentError(absl::StrFormat("--attention: %s", choice.status().message()));
  options.attention = *choice;
  return options;
}

bool Records(const EpisodeRecorder::Options& options) {
  return !options.video_folder.empty() || !options.npz_folder.empty() || !options.picture_folder.empty();
}

// What the flags ask to be played, the environment left out; nothing for --protocol=final.
absl::StatusOr<std::vector<EvalPart>> PartsFromFlags() {
  const std::string protocol = absl::GetFlag(FLAGS_protocol);
  EvaluationOptions options;
  options.seed = absl::GetFlag(FLAGS_seed).value_or(0);
  options.episodes = absl::GetFlag(FLAGS_episodes).value_or(20);
  options.greedy = absl::GetFlag(FLAGS_deterministic);
  CRAFTFLEET_RETURN_IF_ERROR(options.Validate());
  if (protocol.empty()) return std::vector<EvalPart>{{options.greedy ? "argmax" : "sampled", options}};
  if (protocol != "final") {
    return absl::InvalidArgumentError(absl::StrFormat("--protocol=%s, want final or nothing", protocol));
  }
  if (absl::GetFlag(FLAGS_env) || absl::GetFlag(FLAGS_seed) || absl::GetFlag(FLAGS_episodes) || options.greedy) {
    return absl::InvalidArgumentError(
        "--protocol=final plays what the run's configuration says: leave --env, --seed, --episodes and --deterministic "
        "away");
  }
  return std::vector<EvalPart>();
}

absl::StatusOr<EvalPlan> MakePlan(std::vector<EvalPart> parts, const v1::CheckpointState& state) {
  if (parts.empty()) return FinalEvaluation(state);
  EvalPlan plan{state.config().env(), std::move(parts)};
  if (const auto env = absl::GetFlag(FLAGS_env)) plan.env.set_name(*env);
  return plan;
}

// Environment server and session for the games of an evaluation.
struct Games {
  std::unique_ptr<EnvServiceImpl> service;
  std::unique_ptr<wire::Server> server;
  std::unique_ptr<EnvClient> client;
};

absl::StatusOr<Games> OpenGames(const v1::EnvConfig& env, const AgentSpec& spec,
                                const EpisodeRecorder::Options& recorder) {
  const double timeout = absl::GetFlag(FLAGS_env_timeout);
  if (!(timeout >= 0.1 && timeout <= 3600)) {
    return absl::InvalidArgumentError(absl::StrFormat("--env_timeout=%g, want 0.1..3600", timeout));
  }
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string textures, TextureDir(absl::GetFlag(FLAGS_textures)));
  Games games;
  CRAFTFLEET_ASSIGN_OR_RETURN(games.service, EnvServiceImpl::Create(textures));
  CRAFTFLEET_ASSIGN_OR_RETURN(games.server, wire::Server::Create({}, {games.service.get()}));
  v1::SessionHello hello;
  hello.set_protocol_version(wire::kProtocolVersion);
  *hello.mutable_env() = env;
  if (Records(recorder)) hello.mutable_recording()->set_picture_size(recorder.picture_size);
  games.client = std::make_unique<EnvClient>(games.server->InProcess(), hello, static_cast<int>(spec.frame_bytes()),
                                             absl::Seconds(timeout));
  CRAFTFLEET_RETURN_IF_ERROR(games.client->Connect(absl::Seconds(5)));
  return games;
}

void PrintProgress(int finished, int episodes) {
  if (isatty(STDERR_FILENO) != 1) return;
  absl::FPrintF(stderr, "\r%d/%d episodes%s", finished, episodes, finished == episodes ? "\n" : "");
}

// Each part of several has a folder of its own in the recorder's.
EpisodeRecorder::Options InFolderOf(const EvalPart& part, EpisodeRecorder::Options options) {
  for (std::string* folder : {&options.video_folder, &options.npz_folder, &options.picture_folder}) {
    if (!folder->empty()) *folder = JoinPath(*folder, part.name);
  }
  return options;
}

absl::StatusOr<ScoreBoard> Play(const EvalPart& part, EpisodeRecorder::Options options, const Policy& policy,
                                EnvClient* env) {
  std::unique_ptr<EpisodeRecorder> recorder;
  if (Records(options)) {
    options.first_episode = part.options.first_episode;
    CRAFTFLEET_ASSIGN_OR_RETURN(recorder, EpisodeRecorder::Create(options, &policy, absl::Now()));
  }
  const auto progress = [&](int finished) { PrintProgress(finished, part.options.episodes); };
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::vector<Episode> episodes,
                              Evaluate(part.options, policy, env, progress, recorder.get()));
  ScoreBoard board;
  for (const Episode& episode : episodes) board.Add(episode);
  return board;
}

nlohmann::ordered_json DescribeCheckpoint(const v1::CheckpointState& state, const EvalPlan& plan) {
  return {{"run_id", state.run_id()},
          {"agent", state.config().agent()},
          {"env", plan.env.name()},
          {"env_steps_trained", state.env_steps()},
          {"seed", plan.parts[0].options.seed}};
}

// Episodes come out as the run's own evaluations do, where this CPU can.
absl::Status ComputeAsTheRun(v1::RunConfig::Cpu cpu) {
  const absl::Status status = CheckCpu(cpu);
  if (status.ok()) return PinCpu(cpu);
  LogWarning("%s; here its policy may act otherwise", status.message());
  return absl::OkStatus();
}

absl::Status Run() {
  if (absl::GetFlag(FLAGS_checkpoint).empty()) {
    return absl::InvalidArgumentError("--checkpoint is missing: a run's folder or a checkpoint's");
  }
  CRAFTFLEET_ASSIGN_OR_RETURN(std::vector<EvalPart> parts, PartsFromFlags());
  CRAFTFLEET_ASSIGN_OR_RETURN(EpisodeRecorder::Options recorder, RecorderOptions());
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string folder, FindCheckpoint(absl::GetFlag(FLAGS_checkpoint)));
  CRAFTFLEET_ASSIGN_OR_RETURN(const Checkpoint checkpoint, LoadCheckpoint(folder, ""));
  const v1::RunConfig& config = checkpoint.state.config();
  CRAFTFLEET_RETURN_IF_ERROR(ComputeAsTheRun(config.cpu()));
  SetUpTorchThread();
  CRAFTFLEET_ASSIGN_OR_RETURN(const EvalPlan plan, MakePlan(std::move(parts), checkpoint.state));
  CRAFTFLEET_ASSIGN_OR_RETURN(const AgentSpec spec, MakeAgentSpec(config));
  recorder.frame_size = spec.frame_size;
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::unique_ptr<const Policy> policy,
                              Policy::Create(spec, checkpoint.weights, config.tile()));
  CRAFTFLEET_ASSIGN_OR_RETURN(const Games games, OpenGames(plan.env, spec, recorder));

  absl::PrintF("%s of run %s, %s after %d steps, on %s\n", folder, checkpoint.state.run_id(), config.agent(),
               checkpoint.state.env_steps(), plan.env.name());
  nlohmann::ordered_json json = DescribeCheckpoint(checkpoint.state, plan);
  const bool several = plan.parts.size() > 1;
  for (const EvalPart& part : plan.parts) {
    CRAFTFLEET_ASSIGN_OR_RETURN(const ScoreBoard board, Play(part, several ? InFolderOf(part, recorder) : recorder,
                                                             *policy, games.client.get()));
    if (several) absl::PrintF("\n%s episodes\n", part.name);
    std::fputs(DescribeResult(board).c_str(), stdout);
    nlohmann::ordered_json& out = several ? json[part.name] : json;
    out["deterministic"] = part.options.greedy;
    AddResult(board, &out);
  }
  if (absl::GetFlag(FLAGS_json).empty()) return absl::OkStatus();
  return ReplaceFile(absl::GetFlag(FLAGS_json), json.dump(2) + "\n");
}

}  // namespace
}  // namespace craftfleet

int main(int argc, char** argv) {
  craftfleet::ParseFlags(craftfleet::kProgram, craftfleet::kUsage, argc, argv);
  return craftfleet::ExitCode(craftfleet::kProgram, craftfleet::Run());
}
