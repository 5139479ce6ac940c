// craftfleet watch: an agent plays, live in a window or a terminal, as a video, or as a strip of pictures.

#include <unistd.h>

#include <atomic>
#include <iostream>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <absl/flags/flag.h>
#include <absl/strings/match.h>
#include <absl/strings/numbers.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/strings/str_split.h>
#include <opencv2/imgproc.hpp>

#include "actor/recording/video_file.h"
#include "common/base/clock.h"
#include "common/base/numbers.h"
#include "common/base/status_macros.h"
#include "common/base/status_prefix.h"
#include "common/config/known_canary.h"
#include "common/io/output_file.h"
#include "common/io/png_encoder.h"
#include "common/io/texture_digest.h"
#include "common/process/flag_values.h"
#include "common/process/program.h"
#include "common/process/shared_flags.h"
#include "common/telemetry/log.h"
#include "deploy/cli/checkpoint_policy.h"
#include "deploy/cli/command.h"
#include "deploy/cli/screen/game_flags.h"
#include "deploy/cli/screen/view_picture.h"
#include "deploy/cli/watch/attention_strip.h"
#include "deploy/cli/watch/watch_loop.h"
#include "deploy/cli/watch/watch_view.h"
#include "learner/run/checkpoint_store.h"

ABSL_FLAG(double, speed, 5, "steps a second, 0.25..256; the keys + and - change it");
ABSL_FLAG(bool, follow, false, "before each episode, load the run's newest checkpoint");
ABSL_FLAG(std::string, strip, "",
          "write a strip of pictures with attention to this PNG file instead of showing the game");
ABSL_FLAG(std::string, strip_steps, "auto", "steps of the strip's columns, such as 0,40,80; auto: around achievements");
ABSL_FLAG(int32_t, strip_columns, 6, "number of columns with --strip_steps=auto, 1..32");

namespace craftfleet {
namespace {

constexpr char kProgram[] = "craftfleet watch";
constexpr char kUsage[] =
    R"(craftfleet watch RUN shows how the agent of a run or checkpoint plays: the game, the rewards, the value of each moment and
the probability of each action. It plays in a window, in a terminal, or into a file. h shows the keys.

  craftfleet watch runs/first
  craftfleet watch --terminal --follow runs/first
  craftfleet watch --video=episode.mp4 runs/first/checkpoints/iter-00000010
  craftfleet watch --strip=attention.png --attention=mean runs/oc_sa)";

int PictureSize() { return absl::GetFlag(FLAGS_size).value_or(512); }

absl::Status CheckFlags() {
  CRAFTFLEET_RETURN_IF_ERROR(CheckEpisodeAndSize(absl::GetFlag(FLAGS_episode), PictureSize()));
  CRAFTFLEET_RETURN_IF_ERROR(CheckFlagRange("speed", absl::GetFlag(FLAGS_speed), 0.25, 256.0));
  CRAFTFLEET_RETURN_IF_ERROR(CheckFlagRange("strip_columns", absl::GetFlag(FLAGS_strip_columns), 1, 32));
  const std::string video = absl::GetFlag(FLAGS_video);
  if (!video.empty() && !absl::EndsWith(video, ".mp4"))
    return InvalidFlag("video", video, "a file name that ends in .mp4");
  const std::string strip = absl::GetFlag(FLAGS_strip);
  if (!strip.empty() && !absl::EndsWith(strip, ".png"))
    return InvalidFlag("strip", strip, "a file name that ends in .png");
  if (!video.empty() && !strip.empty()) return absl::InvalidArgumentError("--video and --strip: want one of them");
  const absl::string_view file = !video.empty() ? "--video" : !strip.empty() ? "--strip" : "";
  for (const auto& [name, is_set] :
       {std::pair("--follow", absl::GetFlag(FLAGS_follow)), std::pair("--terminal", absl::GetFlag(FLAGS_terminal))}) {
    if (!file.empty() && is_set) {
      return absl::InvalidArgumentError(absl::StrCat(name, " and ", file, ": want one of them"));
    }
  }
  return absl::OkStatus();
}

// The steps of --strip_steps, ascending; empty for auto.
absl::StatusOr<std::vector<int64_t>> StripSteps() {
  std::vector<int64_t> steps;
  const std::string text = absl::GetFlag(FLAGS_strip_steps);
  if (text == "auto") return steps;
  for (const absl::string_view part : absl::StrSplit(text, ',')) {
    int64_t step = 0;
    if (!absl::SimpleAtoi(part, &step) || step < 0 || (!steps.empty() && step <= steps.back()) || steps.size() == 32) {
      return InvalidFlag("strip_steps", text, "auto or at most 32 steps from 0, ascending, such as 0,40,80");
    }
    steps.push_back(step);
  }
  return steps;
}

absl::StatusOr<AgentGame::Options> GameOptions(const CheckpointPolicy& agent) {
  const v1::EnvConfig& env = agent.state.config().env();
  AgentGame::Options options;
  CRAFTFLEET_ASSIGN_OR_RETURN(options.env, EnvFromFlag(absl::GetFlag(FLAGS_env).value_or(env.name())));
  options.length = env.length();
  options.frame_size = agent.spec.frame_size;
  CRAFTFLEET_ASSIGN_OR_RETURN(options.seed, EnvSeedFromFlag());
  options.greedy = absl::GetFlag(FLAGS_deterministic);
  const std::string textures = absl::GetFlag(FLAGS_textures);
  CRAFTFLEET_ASSIGN_OR_RETURN(options.textures, TexturesFromFlag(textures));
  std::string digest(kBuiltInTextures);
  if (!textures.empty()) {
    CRAFTFLEET_ASSIGN_OR_RETURN(digest, TextureDigest(textures));
  }
  if (const absl::Status same = CheckTextures(agent.state, digest); !same.ok()) LogWarning("%s", same.message());
  return options;
}

std::string TitleOf(const CheckpointPolicy& agent) {
  return absl::StrCat(agent.state.config().agent(), ", ", WithCommas(agent.state.env_steps()), " steps");
}

// The source of agents for live play: the loaded one or, with --follow, the newest of the run.
std::function<absl::StatusOr<WatchedAgent>()> AgentSource(const std::string& path, CheckpointPolicy first) {
  return [path, agent = std::move(first)]() mutable -> absl::StatusOr<WatchedAgent> {
    if (absl::GetFlag(FLAGS_follow)) {
      const absl::StatusOr<std::string> newest = FindCheckpoint(path);
      if (newest.ok() && *newest != agent.folder) {
        // A checkpoint may be removed while it is read; then the next episode gets a newer one.
        absl::StatusOr<CheckpointPolicy> loaded = LoadPolicy(path);
        if (loaded.ok()) agent = *std::move(loaded);
      }
    }
    return WatchedAgent{TitleOf(agent), agent.policy};
  };
}

// What is shown live, uint8[height,width,3].
absl::StatusOr<cv::Mat> DrawPicture(const std::string& title, const std::optional<AttentionChoice>& attention,
                                    AgentGame* game) {
  const PictureRoom room = {PictureSize(), PictureSize()};
  CRAFTFLEET_ASSIGN_OR_RETURN(const View view, DrawMoment(title, room, attention, game));
  cv::Mat rgb;
  cv::cvtColor(DrawView(view, room), rgb, cv::COLOR_BGR2RGB);
  return rgb;
}

// Counts the steps of an episode in place, on standard error if that is a terminal. The destructor clears the line.
class StepLine {
 public:
  StepLine() = default;
  ~StepLine() {
    if (terminal_) std::cerr << kClearLine << std::flush;
  }
  StepLine(const StepLine&) = delete;
  StepLine& operator=(const StepLine&) = delete;

  void Show(int64_t steps) const {
    if (terminal_) std::cerr << kClearLine << steps << " steps" << std::flush;
  }

 private:
  static constexpr char kClearLine[] = "\r\033[K";
  const bool terminal_ = isatty(STDERR_FILENO) == 1;
};

// Plays an episode to its end, or until `stop`.
absl::Status WriteVideo(const CheckpointPolicy& agent, const AgentGame::Options& game_options,
                        const std::optional<AttentionChoice>& attention, const std::atomic<bool>& stop) {
  CRAFTFLEET_ASSIGN_OR_RETURN(const auto game,
                              AgentGame::Create(game_options, agent.policy, absl::GetFlag(FLAGS_episode)));
  const std::string path = absl::GetFlag(FLAGS_video);
  const std::string title = TitleOf(agent);
  std::optional<StepLine> line(std::in_place);
  std::unique_ptr<VideoFile> video;
  while (true) {
    CRAFTFLEET_ASSIGN_OR_RETURN(const cv::Mat picture, DrawPicture(title, attention, game.get()));
    if (video == nullptr) {
      CRAFTFLEET_ASSIGN_OR_RETURN(video, WithPrefix("--video", VideoFile::Create(path, picture.cols, picture.rows)));
    }
    CRAFTFLEET_RETURN_IF_ERROR(
        video->Append({reinterpret_cast<const char*>(picture.data), picture.total() * picture.elemSize()}));
    if (stop || game->ended()) break;
    CRAFTFLEET_RETURN_IF_ERROR(game->Step());
    line->Show(game->world().step());
  }
  line.reset();
  CRAFTFLEET_RETURN_IF_ERROR(video->Finish(path));
  absl::PrintF("%s: %s, episode %d, %d steps, reward %.1f\n", path, title, game->world().episode(),
               game->world().step(), game->world().episode_reward());
  return absl::OkStatus();
}

absl::Status WriteStrip(const CheckpointPolicy& agent, const AgentGame::Options& game_options,
                        const AttentionChoice& attention, std::vector<int64_t> steps, const std::atomic<bool>& stop) {
  const int64_t episode = absl::GetFlag(FLAGS_episode);
  const std::string path = absl::GetFlag(FLAGS_strip);
  CRAFTFLEET_ASSIGN_OR_RETURN(OutputFile file, OutputFile::Open("--strip", path));
  CRAFTFLEET_ASSIGN_OR_RETURN(const auto game, AgentGame::Create(game_options, agent.policy, episode));
  CRAFTFLEET_RETURN_IF_ERROR(game->Attention().status());
  std::optional<StepLine> line(std::in_place);
  const StepListener show = [&line](int64_t step) { line->Show(step); };
  if (steps.empty()) {
    CRAFTFLEET_ASSIGN_OR_RETURN(const EpisodeOutline outline, PlayOutline(stop, show, game.get()));
    steps = ChooseSteps(outline.unlocks, outline.length, absl::GetFlag(FLAGS_strip_columns));
    CRAFTFLEET_RETURN_IF_ERROR(game->Start(agent.policy, episode));
  }
  CRAFTFLEET_ASSIGN_OR_RETURN(const auto columns, TakeColumns(steps, attention, stop, show, game.get()));
  line.reset();
  if (columns.empty()) {
    return absl::InvalidArgumentError(absl::StrCat("--strip_steps=", absl::GetFlag(FLAGS_strip_steps),
                                                   ": the episode has ", game->world().step(), " steps"));
  }
  const StripPicture strip = DrawStrip(columns);
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string png, EncodePng(strip.pixels, strip.width, strip.height));
  CRAFTFLEET_RETURN_IF_ERROR(file.Write(png));
  absl::PrintF("%s: %d columns of episode %d\n", path, columns.size(), episode);
  return absl::OkStatus();
}

absl::Status Run(const std::vector<std::string>& paths) {
  if (paths.size() != 1)
    return absl::InvalidArgumentError(absl::StrCat(paths.size(), " runs, want one run or checkpoint"));
  CRAFTFLEET_RETURN_IF_ERROR(CheckFlags());
  if (absl::GetFlag(FLAGS_follow) && FindCheckpoint(paths[0]).value_or("") == paths[0]) {
    return absl::InvalidArgumentError(absl::StrCat("--follow: ", paths[0], " is one checkpoint, want a run's folder"));
  }
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::optional<AttentionChoice> attention, AttentionFromFlag());
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::vector<int64_t> steps, StripSteps());
  const bool on_screen = absl::GetFlag(FLAGS_video).empty() && absl::GetFlag(FLAGS_strip).empty();
  if (on_screen) CRAFTFLEET_RETURN_IF_ERROR(CheckScreen(absl::GetFlag(FLAGS_terminal)));  // before LibTorch's threads
  CRAFTFLEET_ASSIGN_OR_RETURN(CheckpointPolicy agent, LoadPolicy(paths[0]));
  CRAFTFLEET_ASSIGN_OR_RETURN(const AgentGame::Options game_options, GameOptions(agent));
  std::atomic<bool> stop{false};
  StopSignal signal([&stop] { stop = true; });  // before the window system starts threads
  if (!absl::GetFlag(FLAGS_video).empty()) return WriteVideo(agent, game_options, attention, stop);
  if (!absl::GetFlag(FLAGS_strip).empty()) {
    return WriteStrip(agent, game_options, attention.value_or(AttentionChoice()), steps, stop);
  }
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::unique_ptr<Screen> screen,
                              OpenScreen(absl::GetFlag(FLAGS_terminal), kProgram, PictureSize()));
  WatchOptions options;
  options.speed = absl::GetFlag(FLAGS_speed);
  options.episode = absl::GetFlag(FLAGS_episode);
  options.attention = attention;
  options.agent = AgentSource(paths[0], std::move(agent));
  RealClock clock;
  return WatchOnScreen(options, game_options, stop, &clock, screen.get());
}

int RunWatch(int argc, char** argv) {
  const std::vector<std::string> paths = ParseFlagsAndArguments(
      {kProgram,
       kUsage,
       {"env", "seed", "episode", "deterministic", "terminal", "speed", "attention", "follow", "video", "strip"},
       {"watch_command.cc", "size", "textures"},
       {{"seed", "seed of the environment; the same episodes as craftfleet eval --seed [0]"},
        {"size", "width and height of the picture in windows and videos, in pixels, 64..1024 [512]"},
        {"video", "write one episode to this MP4 file instead of showing it"}}},
      argc, argv);
  const absl::Status status = Run(paths);
  const int exit_code = ExitCode(kProgram, status);
  return absl::IsCancelled(status) ? kStoppedExitCode : exit_code;
}

const RegisterCommand kRegistered("watch", &RunWatch);

}  // namespace
}  // namespace craftfleet
