// craftfleet play: a person plays the game, in a window or a terminal.

#include <atomic>
#include <memory>
#include <optional>
#include <random>
#include <string>

#include <absl/flags/flag.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/time/clock.h>

#include "common/base/clock.h"
#include "common/base/status_macros.h"
#include "common/config/env_name.h"
#include "common/process/program.h"
#include "deploy/cli/play/play_loop.h"
#include "deploy/cli/play/play_session.h"
#include "deploy/cli/screen/terminal_screen.h"
#include "deploy/cli/screen/window_screen.h"

ABSL_FLAG(std::string, env, "crafter",
          "environment to play, such as crafter:numbers=hard-x2; craftfleet envs lists them");
ABSL_FLAG(std::optional<int64_t>, seed, std::nullopt, "seed of the environment [a new one each time]");
ABSL_FLAG(int64_t, episode, 1, "episode of the environment to begin with, 1..1000000000");
ABSL_FLAG(bool, terminal, false, "play in the terminal, also over ssh, instead of a window; needs 24-bit colours");
ABSL_FLAG(double, fps, 5, "steps a second, 0.1..60");
ABSL_FLAG(bool, wait, false, "wait for a key before each step, instead of --fps");
ABSL_FLAG(int32_t, size, 576, "width and height of the picture in a window, in pixels, 64..1024");
ABSL_FLAG(std::string, record, "", "folder for a video and a NumPy file of each episode");
ABSL_FLAG(std::string, textures, "", "folder with Crafter's textures as PNG [the ones that come with this program]");

namespace craftfleet {
namespace {

constexpr char kProgram[] = "craftfleet play";
constexpr char kUsage[] =
    R"(craftfleet play lets you play the game that agents play, in a window or, with --terminal, in a terminal. h shows the keys.
With the same --seed, the same keys lead to the same game.

  craftfleet play
  craftfleet play --terminal --wait
  craftfleet play --env=crafter:numbers=hard-x2 --seed=7 --record=recordings)";

template <typename Value>
absl::Status OutOfRange(const char* flag, Value value, const char* wanted) {
  return absl::InvalidArgumentError(absl::StrCat("--", flag, "=", value, ", want ", wanted));
}

int64_t NewSeed() { return static_cast<int64_t>(std::random_device()() >> 1); }

absl::StatusOr<PlaySession::Options> SessionOptions() {
  PlaySession::Options options;
  absl::StatusOr<EnvName> env = EnvName::Parse(absl::GetFlag(FLAGS_env));
  if (!env.ok()) return absl::InvalidArgumentError(absl::StrFormat("--env: %s", env.status().message()));
  options.env = *env;
  options.seed = absl::GetFlag(FLAGS_seed).value_or(NewSeed());
  options.episode = absl::GetFlag(FLAGS_episode);
  if (options.episode < 1 || options.episode > 1'000'000'000) {
    return OutOfRange("episode", options.episode, "1..1000000000");
  }
  options.record_folder = absl::GetFlag(FLAGS_record);
  options.start = absl::Now();
  const std::string folder = absl::GetFlag(FLAGS_textures);
  options.textures = Textures::BuiltIn();
  if (!folder.empty()) {
    absl::StatusOr<std::shared_ptr<const Textures>> textures = Textures::Load(folder);
    if (!textures.ok()) {
      return absl::Status(textures.status().code(),
                          absl::StrFormat("--textures=%s: %s", folder, textures.status().message()));
    }
    options.textures = *std::move(textures);
  }
  return options;
}

absl::StatusOr<absl::Duration> StepTime() {
  const double fps = absl::GetFlag(FLAGS_fps);
  if (!(fps >= 0.1 && fps <= 60)) return OutOfRange("fps", fps, "0.1..60");
  return absl::GetFlag(FLAGS_wait) ? absl::InfiniteDuration() : absl::Seconds(1 / fps);
}

absl::StatusOr<std::unique_ptr<Screen>> OpenScreen() {
  const int size = absl::GetFlag(FLAGS_size);
  if (size < 64 || size > 1024) return OutOfRange("size", size, "64..1024");
  if (absl::GetFlag(FLAGS_terminal)) return TerminalScreen::Open();
  return OpenWindow("craftfleet play", {size, size});
}

absl::Status Run() {
  CRAFTFLEET_ASSIGN_OR_RETURN(const PlaySession::Options options, SessionOptions());
  CRAFTFLEET_ASSIGN_OR_RETURN(const absl::Duration step_time, StepTime());
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::unique_ptr<PlaySession> session, PlaySession::Create(options));
  std::atomic<bool> stop{false};
  StopSignal signal([&stop] { stop = true; });  // before the window system starts threads
  CRAFTFLEET_ASSIGN_OR_RETURN(std::unique_ptr<Screen> screen, OpenScreen());
  RealClock clock;
  const absl::Status played = PlayOnScreen(step_time, stop, &clock, session.get(), screen.get());
  screen = nullptr;  // gives the terminal back
  const absl::Status finished = session->Finish();
  absl::PrintF("%s\n", session->Summary());
  return played.ok() ? finished : played;
}

}  // namespace
}  // namespace craftfleet

int main(int argc, char** argv) {
  craftfleet::ParseFlags(craftfleet::kProgram, craftfleet::kUsage, argc, argv,
                         {"env", "seed", "episode", "terminal", "fps", "wait", "size", "record", "textures"});
  return craftfleet::ExitCode(craftfleet::kProgram, craftfleet::Run());
}
