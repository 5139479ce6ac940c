// craftfleet eval: scores a checkpoint and records its episodes.

#include <unistd.h>

#include <atomic>
#include <cstdio>
#include <iostream>
#include <optional>
#include <utility>

#include <absl/flags/flag.h>
#include <absl/strings/str_format.h>
#include <absl/time/clock.h>
#include <nlohmann/json.hpp>

#include "actor/evaluator.h"
#include "actor/recording/episode_recorder.h"
#include "common/agent/agent_spec.h"
#include "common/base/clock.h"
#include "common/base/crafter.h"
#include "common/base/status_macros.h"
#include "common/io/files.h"
#include "common/io/output_file.h"
#include "common/io/paths.h"
#include "common/process/flag_values.h"
#include "common/process/program.h"
#include "common/process/shared_flags.h"
#include "common/telemetry/log.h"
#include "common/wire/protocol.h"
#include "common/wire/server.h"
#include "deploy/cli/checkpoint_policy.h"
#include "deploy/cli/command.h"
#include "deploy/cli/screen/game_flags.h"
#include "envserver/env_service.h"
#include "learner/run/progress.h"
#include "learner/run/score.h"

ABSL_FLAG(std::optional<craftfleet::Count>, episodes, std::nullopt, "episodes to play, 1..10000 [20]");
ABSL_FLAG(std::string, protocol, "",
          "final: replay the run's final evaluation\n"
          "argmax episodes, then sampled ones, as in the run's configuration");
ABSL_FLAG(std::string, out, "", "file to which the result is also written as JSON; -: standard output");
ABSL_FLAG(std::string, episodes_npz, "",
          "folder for a NumPy file of each episode, in the format of Crafter's own recorder");
ABSL_FLAG(std::string, pictures, "", "folder for a picture of every --picture_every steps, PNG");
ABSL_FLAG(int32_t, picture_every, 50, "steps from one picture to the next, 1..10000");

namespace craftfleet {
namespace {

constexpr char kProgram[] = "craftfleet eval";
constexpr char kUsage[] =
    R"(craftfleet eval plays whole episodes with the policy of a checkpoint. It prints the success rate of each achievement, the
mean reward and episode length, and the Crafter score. The result depends only on the weights, the environment, the textures
and the seed.

  craftfleet eval --checkpoint=runs/first --episodes=100
  craftfleet eval --checkpoint=runs/first/checkpoints/iter-00000010 --env=crafter:numbers=easy-x2 --deterministic --out=eval.json
  craftfleet eval --checkpoint=runs/first --protocol=final --video=videos --episodes_npz=episodes
  craftfleet eval --checkpoint=runs/oc_ca --episodes=3 --video=videos --attention=sum

Ctrl-C, SIGTERM or closing the terminal ends it. It then prints the result of the finished episodes and exits with 130.)";

// A set of episodes with a common result.
struct EvalPart {
  std::string name;  // "argmax", "sampled"
  EvaluationOptions options;
};

struct EvalPlan {
  v1::EnvConfig env;
  std::vector<EvalPart> parts;
};

// The final evaluation of the run that ends with the checkpoint `state`: the same episodes with the same results as in
// its final_argmax.jsonl and final_sampled.jsonl.
//   InvalidArgument: its configuration has no final evaluation.   FailedPrecondition: `state` is of results, which do
//   not say how many episodes the evaluations before had.
absl::StatusOr<EvalPlan> FinalEvaluation(const v1::CheckpointState& state) {
  const v1::EvalConfig& eval = state.config().eval();
  if (eval.final_episodes() == 0) {
    return absl::InvalidArgumentError(
        "the run has no final evaluation (eval.final_episodes is 0 in its configuration): give --episodes instead");
  }
  if (state.next_eval_episode() == 0) {
    return absl::FailedPreconditionError(
        "a folder of results does not say which episodes the final evaluation had: give a run or a checkpoint, or "
        "--episodes");
  }
  EvalPlan plan;
  plan.env = state.config().env();
  plan.env.set_name(eval.env());
  EvaluationOptions options;
  options.seed = eval.seed();
  options.episodes = eval.final_episodes();
  options.first_episode = state.next_eval_episode();
  options.greedy = true;
  plan.parts.push_back({"argmax", options});
  options.first_episode += options.episodes;
  options.greedy = false;
  plan.parts.push_back({"sampled", options});
  return plan;
}

// The recordings that the flags request.
absl::StatusOr<EpisodeRecorder::Options> RecorderOptions() {
  EpisodeRecorder::Options options;
  options.video_folder = absl::GetFlag(FLAGS_video);
  options.npz_folder = absl::GetFlag(FLAGS_episodes_npz);
  options.picture_folder = absl::GetFlag(FLAGS_pictures);
  options.picture_every = absl::GetFlag(FLAGS_picture_every);
  CRAFTFLEET_RETURN_IF_ERROR(CheckFlagRange("picture_every", options.picture_every, 1, 10000));
  const int size = absl::GetFlag(FLAGS_size).value_or(576);
  if (size < 64 || size > 1024 || size % 2 != 0) return InvalidFlag("size", size, "an even number 64..1024");
  const bool pictures = !options.video_folder.empty() || !options.picture_folder.empty();
  if (pictures) options.picture_size = size;
  CRAFTFLEET_ASSIGN_OR_RETURN(options.attention, AttentionFromFlag());
  if (!options.attention.has_value()) return options;
  if (!pictures) return absl::InvalidArgumentError("--attention needs --video or --pictures");
  return options;
}

bool Records(const EpisodeRecorder::Options& options) {
  return !options.video_folder.empty() || !options.npz_folder.empty() || !options.picture_folder.empty();
}

absl::StatusOr<int> EpisodesFromFlag() {
  const int64_t episodes = absl::GetFlag(FLAGS_episodes).value_or(Count{20}).value;
  CRAFTFLEET_RETURN_IF_ERROR(CheckFlagRange<int64_t>("episodes", episodes, 1, 10000));
  return static_cast<int>(episodes);
}

// The parts that the flags describe, without the environment; empty for --protocol=final.
absl::StatusOr<std::vector<EvalPart>> PartsFromFlags() {
  const std::string protocol = absl::GetFlag(FLAGS_protocol);
  if (const auto env = absl::GetFlag(FLAGS_env)) CRAFTFLEET_RETURN_IF_ERROR(EnvFromFlag(*env).status());
  EvaluationOptions options;
  CRAFTFLEET_ASSIGN_OR_RETURN(options.seed, EnvSeedFromFlag());
  CRAFTFLEET_ASSIGN_OR_RETURN(options.episodes, EpisodesFromFlag());
  options.greedy = absl::GetFlag(FLAGS_deterministic);
  CRAFTFLEET_RETURN_IF_ERROR(options.Validate());
  if (protocol.empty()) return std::vector<EvalPart>{{options.greedy ? "argmax" : "sampled", options}};
  if (protocol != "final") return InvalidFlag("protocol", protocol, "final or nothing");
  if (absl::GetFlag(FLAGS_env) || absl::GetFlag(FLAGS_seed) || absl::GetFlag(FLAGS_episodes) || options.greedy) {
    return absl::InvalidArgumentError(
        "--protocol=final replays the evaluation of the run's configuration: omit --env, --seed, --episodes and "
        "--deterministic");
  }
  return std::vector<EvalPart>();
}

absl::StatusOr<EvalPlan> MakePlan(std::vector<EvalPart> parts, const v1::CheckpointState& state) {
  if (parts.empty()) return FinalEvaluation(state);
  EvalPlan plan{state.config().env(), std::move(parts)};
  if (const auto env = absl::GetFlag(FLAGS_env)) plan.env.set_name(*env);
  return plan;
}

// The environment server and the session that play an evaluation.
struct Games {
  std::unique_ptr<EnvServiceImpl> service;
  std::unique_ptr<wire::Server> server;
  std::unique_ptr<EnvClient> client;
};

absl::StatusOr<Games> OpenGames(const v1::EnvConfig& env, const AgentSpec& spec,
                                const EpisodeRecorder::Options& recorder) {
  const absl::Duration timeout = absl::GetFlag(FLAGS_env_timeout).value;
  CRAFTFLEET_RETURN_IF_ERROR(CheckFlagRange("env_timeout", timeout, absl::Milliseconds(100), absl::Hours(1)));
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string textures, TextureDir(absl::GetFlag(FLAGS_textures)));
  Games games;
  CRAFTFLEET_ASSIGN_OR_RETURN(games.service, EnvServiceImpl::Create(textures));
  CRAFTFLEET_ASSIGN_OR_RETURN(games.server, wire::Server::Create({}, {games.service.get()}));
  v1::SessionHello hello;
  hello.set_protocol_version(wire::kProtocolVersion);
  *hello.mutable_env() = env;
  if (Records(recorder)) hello.mutable_recording()->set_picture_size(recorder.picture_size);
  games.client =
      std::make_unique<EnvClient>(games.server->InProcess(), hello, static_cast<int>(spec.frame_bytes()), timeout);
  CRAFTFLEET_RETURN_IF_ERROR(games.client->Connect(absl::Seconds(5)));
  return games;
}

// Other textures than the run's are refused for --protocol=final, and otherwise only reported.
absl::Status CompareTextures(const v1::CheckpointState& state, const std::string& digest) {
  const absl::Status same = CheckTextures(state, digest);
  if (same.ok() || !absl::GetFlag(FLAGS_protocol).empty()) return same;
  LogWarning("%s", same.message());
  return absl::OkStatus();
}

// If there are several parts, each records into its own subfolder.
EpisodeRecorder::Options InFolderOf(const EvalPart& part, EpisodeRecorder::Options options) {
  for (std::string* folder : {&options.video_folder, &options.npz_folder, &options.picture_folder}) {
    if (!folder->empty()) *folder = JoinPath(*folder, part.name);
  }
  return options;
}

// On a terminal a line that is redrawn, otherwise one every 10 s: "sampled: 12 of 100 episodes, 40s left".
class EvalProgress {
 public:
  EvalProgress(std::string part, int episodes) : part_(std::move(part)), episodes_(episodes) {}
  ~EvalProgress() {
    if (terminal_) std::cerr << kClearLine << std::flush;
  }
  EvalProgress(const EvalProgress&) = delete;
  EvalProgress& operator=(const EvalProgress&) = delete;

  // To be called often; prints only when due.
  void Update(int finished) {
    const absl::Time now = SteadyNow();
    if (now < printed_ + (terminal_ ? absl::Milliseconds(200) : absl::Seconds(10))) return;
    printed_ = now;
    std::string line = absl::StrFormat("%s: %d of %d episodes", part_, finished, episodes_);
    if (finished > 0) {
      const double seconds_each = absl::ToDoubleSeconds(now - start_) / finished;
      absl::StrAppendFormat(&line, ", %s left", FormatTimeLeft(seconds_each * (episodes_ - finished)));
    }
    std::cerr << (terminal_ ? kClearLine : "") << line << (terminal_ ? "" : "\n") << std::flush;
  }

 private:
  static constexpr char kClearLine[] = "\r\033[K";

  const std::string part_;
  const int episodes_;
  const bool terminal_ = isatty(STDERR_FILENO) == 1;
  const absl::Time start_ = SteadyNow();
  absl::Time printed_ = start_;
};

// Plays `part` until all episodes have finished or `stop` becomes true. Returns the finished episodes.
absl::StatusOr<ScoreBoard> Play(const EvalPart& part, EpisodeRecorder::Options options, const Policy& policy,
                                EnvClient* env, const std::atomic<bool>& stop) {
  std::unique_ptr<EpisodeRecorder> recorder;
  if (Records(options)) {
    options.first_episode = part.options.first_episode;
    CRAFTFLEET_ASSIGN_OR_RETURN(
        recorder, EpisodeRecorder::Create(
                      options, [&policy](absl::string_view frame) { return policy.Attention(frame); }, absl::Now()));
  }
  EvalProgress progress(part.name, part.options.episodes);
  CRAFTFLEET_ASSIGN_OR_RETURN(
      const std::vector<Episode> episodes,
      Evaluate(
          part.options, policy, env, [&progress](int finished) { progress.Update(finished); }, recorder.get(), &stop));
  ScoreBoard board;
  for (const Episode& episode : episodes) board.Add(episode);
  return board;
}

// A line for each achievement, then reward, length and score.
std::string DescribeResult(const ScoreBoard& board) {
  std::string text;
  const AchievementPercentages percentages = board.SuccessPercentages();
  for (int i = 0; i < kNumAchievements; ++i) {
    absl::StrAppendFormat(&text, "%-20s %5.1f%%\n", kAchievementNames[i], percentages[i]);
  }
  absl::StrAppendFormat(
      &text, "\nepisodes %d   reward %.2f   length %.1f   achievements unlocked %d/22   Crafter score %.2f\n",
      board.episodes(), board.MeanReward(), board.MeanLength(), board.Unlocked(), board.Score());
  return text;
}

void AddResult(const ScoreBoard& board, nlohmann::ordered_json* json) {
  (*json)["episodes"] = board.episodes();
  (*json)["reward"] = board.MeanReward();
  (*json)["length"] = board.MeanLength();
  (*json)["score"] = board.Score();
  const AchievementPercentages percentages = board.SuccessPercentages();
  for (int i = 0; i < kNumAchievements; ++i) {
    const std::string name(kAchievementNames[i]);
    (*json)["success_percentages"][name] = percentages[i];
  }
}

nlohmann::ordered_json DescribeCheckpoint(const v1::CheckpointState& state, const EvalPlan& plan) {
  return {{"run_id", state.run_id()},
          {"agent", state.config().agent()},
          {"env", plan.env.name()},
          {"env_steps_trained", state.env_steps()},
          {"seed", plan.parts[0].options.seed}};
}

// Plays the parts and prints their results to `text`, until `stop` becomes true. Fills `json`.
//   Cancelled: stopped before the end.
absl::Status PlayAll(const EvalPlan& plan, const EpisodeRecorder::Options& recorder, const Policy& policy,
                     EnvClient* env, const std::atomic<bool>& stop, std::FILE* text, nlohmann::ordered_json* json) {
  const bool several = plan.parts.size() > 1;
  for (const EvalPart& part : plan.parts) {
    CRAFTFLEET_ASSIGN_OR_RETURN(const ScoreBoard board,
                                Play(part, several ? InFolderOf(part, recorder) : recorder, policy, env, stop));
    const bool stopped = board.episodes() < part.options.episodes;
    if (board.episodes() > 0) {
      if (several) absl::FPrintF(text, "\n%s episodes\n", part.name);
      std::fputs(DescribeResult(board).c_str(), text);
      nlohmann::ordered_json& out = several ? (*json)[part.name] : *json;
      out["deterministic"] = part.options.greedy;
      AddResult(board, &out);
    }
    if (!stopped) continue;
    (*json)["stopped"] = true;
    return absl::CancelledError(absl::StrFormat(
        "stopped after %d of %d %s episodes; shorter episodes finish first, so this is not a fair sample",
        board.episodes(), part.options.episodes, part.name));
  }
  return absl::OkStatus();
}

absl::Status Run() {
  if (absl::GetFlag(FLAGS_checkpoint).empty()) {
    return absl::InvalidArgumentError("--checkpoint is missing: the folder of a run or of a checkpoint");
  }
  CRAFTFLEET_ASSIGN_OR_RETURN(std::vector<EvalPart> parts, PartsFromFlags());
  CRAFTFLEET_ASSIGN_OR_RETURN(EpisodeRecorder::Options recorder, RecorderOptions());
  CRAFTFLEET_ASSIGN_OR_RETURN(const CheckpointPolicy agent, LoadPolicy(absl::GetFlag(FLAGS_checkpoint)));
  std::optional<OutputFile> json_file;
  if (const std::string path = absl::GetFlag(FLAGS_out); !path.empty()) {
    CRAFTFLEET_ASSIGN_OR_RETURN(OutputFile file, OutputFile::Open("--out", path));
    json_file.emplace(std::move(file));
  }
  CRAFTFLEET_ASSIGN_OR_RETURN(const EvalPlan plan, MakePlan(std::move(parts), agent.state));
  recorder.frame_size = agent.spec.frame_size;
  std::atomic<bool> stop{false};
  StopSignal signal([&stop] { stop = true; });
  CRAFTFLEET_ASSIGN_OR_RETURN(const Games games, OpenGames(plan.env, agent.spec, recorder));
  CRAFTFLEET_RETURN_IF_ERROR(CompareTextures(agent.state, games.service->texture_digest()));

  std::FILE* const text = json_file.has_value() && json_file->is_standard_output() ? stderr : stdout;
  absl::FPrintF(text, "%s of run %s, %s after %d steps, on %s\n", agent.folder, agent.state.run_id(),
                agent.state.config().agent(), agent.state.env_steps(), plan.env.name());
  CRAFTFLEET_RETURN_IF_ERROR(FinishStandardOutput());  // reports a full disk before the episodes are played
  nlohmann::ordered_json json = DescribeCheckpoint(agent.state, plan);
  const absl::Status played = PlayAll(plan, recorder, *agent.policy, games.client.get(), stop, text, &json);
  if (!played.ok() && !absl::IsCancelled(played)) return played;
  if (json_file.has_value()) CRAFTFLEET_RETURN_IF_ERROR(json_file->Write(json.dump(2) + "\n"));
  return played;
}

int RunEval(int argc, char** argv) {
  OutliveReaders();
  ParseFlags({kProgram,
              kUsage,
              {"checkpoint", "episodes", "env", "seed", "deterministic", "protocol", "out", "video", "episodes_npz",
               "attention"},
              {"eval_command.cc", "env_timeout", "size", "textures"},
              {{"seed", "seed of the environment; the evaluation plays its episodes 1, 2, ... [0]"},
               {"video", "folder for a video of each episode, MP4"},
               {"env_timeout", "how long a step of the games may take, 100ms..1h"},
               {"size", "width and height of videos and pictures in pixels, an even number 64..1024 [576]"}}},
             argc, argv);
  const absl::Status status = Run();
  const int exit_code = ExitCode(kProgram, status);
  return absl::IsCancelled(status) ? kStoppedExitCode : exit_code;
}

const RegisterCommand kRegistered("eval", &RunEval);

}  // namespace
}  // namespace craftfleet
