// craftfleet play: a person plays the game, in a window or a terminal.

#include <atomic>
#include <memory>
#include <optional>
#include <random>
#include <string>

#include <absl/flags/flag.h>
#include <absl/strings/str_format.h>
#include <absl/time/clock.h>

#include "common/base/clock.h"
#include "common/base/status_macros.h"
#include "common/process/flag_values.h"
#include "common/process/program.h"
#include "common/process/shared_flags.h"
#include "deploy/cli/command.h"
#include "deploy/cli/play/play_loop.h"
#include "deploy/cli/play/play_session.h"
#include "deploy/cli/screen/game_flags.h"

ABSL_FLAG(double, fps, 5, "steps a second, 0.1..60");
ABSL_FLAG(bool, wait, false, "wait for a key before each step, instead of --fps");
ABSL_FLAG(std::string, record, "", "folder for a video and a NumPy file of each episode");

namespace craftfleet {
namespace {

constexpr char kProgram[] = "craftfleet play";
constexpr char kUsage[] =
    R"(craftfleet play lets you play the game that agents play, in a window or, with --terminal, in a terminal. h shows the keys.
With the same --seed, the same keys lead to the same game.

  craftfleet play
  craftfleet play --terminal --wait
  craftfleet play --env=crafter:numbers=hard-x2 --seed=7 --record=recordings)";

int64_t NewSeed() { return static_cast<int64_t>(std::random_device()() >> 1); }

absl::StatusOr<PlaySession::Options> SessionOptions() {
  PlaySession::Options options;
  CRAFTFLEET_ASSIGN_OR_RETURN(options.env, EnvFromFlag(absl::GetFlag(FLAGS_env).value_or("crafter")));
  CRAFTFLEET_ASSIGN_OR_RETURN(options.seed, EnvSeedFromFlag(/*otherwise=*/NewSeed()));
  options.episode = absl::GetFlag(FLAGS_episode);
  options.record_folder = absl::GetFlag(FLAGS_record);
  options.start = absl::Now();
  CRAFTFLEET_ASSIGN_OR_RETURN(options.textures, TexturesFromFlag(absl::GetFlag(FLAGS_textures)));
  return options;
}

absl::StatusOr<absl::Duration> StepTime() {
  const double fps = absl::GetFlag(FLAGS_fps);
  CRAFTFLEET_RETURN_IF_ERROR(CheckFlagRange("fps", fps, 0.1, 60.0));
  return absl::GetFlag(FLAGS_wait) ? absl::InfiniteDuration() : absl::Seconds(1 / fps);
}

absl::Status Run() {
  CRAFTFLEET_ASSIGN_OR_RETURN(const PlaySession::Options options, SessionOptions());
  CRAFTFLEET_ASSIGN_OR_RETURN(const absl::Duration step_time, StepTime());
  const int size = absl::GetFlag(FLAGS_size).value_or(576);
  CRAFTFLEET_RETURN_IF_ERROR(CheckEpisodeAndSize(options.episode, size));
  CRAFTFLEET_RETURN_IF_ERROR(CheckScreen(absl::GetFlag(FLAGS_terminal)));  // forks: before anything starts threads
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::unique_ptr<PlaySession> session, PlaySession::Create(options));
  std::atomic<bool> stop{false};
  StopSignal signal([&stop] { stop = true; });  // before the window system starts threads
  CRAFTFLEET_ASSIGN_OR_RETURN(std::unique_ptr<Screen> screen,
                              OpenScreen(absl::GetFlag(FLAGS_terminal), kProgram, size));
  RealClock clock;
  const absl::Status played = PlayOnScreen(step_time, stop, &clock, session.get(), screen.get());
  screen = nullptr;  // gives the terminal back
  const absl::Status finished = session->Finish();
  absl::PrintF("%s\n", session->Summary());
  return played.ok() ? finished : played;
}

int RunPlay(int argc, char** argv) {
  ParseFlags({kProgram,
              kUsage,
              {"env", "seed", "episode", "terminal", "fps", "wait", "size", "record", "textures"},
              {},
              {{"env", "environment to play, such as crafter:numbers=hard-x2; craftfleet envs lists them [crafter]"},
               {"seed", "seed of the environment [a new one each time]"},
               {"size", "width and height of the picture in a window, in pixels, 64..1024 [576]"}}},
             argc, argv);
  return ExitCode(kProgram, Run());
}

const RegisterCommand kRegistered("play", &RunPlay);

}  // namespace
}  // namespace craftfleet
