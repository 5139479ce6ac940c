#include "deploy/cli/watch/watch_loop.h"

#include <algorithm>
#include <utility>
#include <vector>

#include <absl/strings/str_format.h>

#include "common/base/status_macros.h"
#include "deploy/cli/watch/watch_view.h"

namespace craftfleet {
namespace {

constexpr absl::Duration kLongestWait = absl::Milliseconds(200);  // for a key; then `stop` is looked at
constexpr absl::Duration kEndedStays = absl::Seconds(2);
constexpr double kSlowest = 0.25;  // steps a second
constexpr double kFastest = 256;

std::vector<TextLine> KeyHelp() {
  return {
      {"Keys", TextLine::Style::kTitle},
      {"space    pause, continue"},
      {".        one step"},
      {"+ -      faster, slower"},
      {"n        next episode"},
      {"b        previous episode"},
      {"r        this episode again"},
      {"a        attention (oc_sa, oc_ca)"},
      {"h        this help"},
      {"q, esc   quit"},
  };
}

// One person's session.
class Watching {
 public:
  Watching(const WatchOptions& options, const std::atomic<bool>& stop, Clock* clock, Screen* screen)
      : options_(options), stop_(stop), clock_(clock), screen_(screen) {
    state_.speed = options.speed;
    state_.attention = options.attention.has_value();
  }

  absl::Status Run(const AgentGame::Options& game_options) {
    CRAFTFLEET_ASSIGN_OR_RETURN(agent_, options_.agent());
    CRAFTFLEET_ASSIGN_OR_RETURN(game_, AgentGame::Create(game_options, agent_.policy, options_.episode));
    absl::Time shown = clock_->Now();  // since when the current moment has been on the screen
    while (!stop_ && !state_.quit) {
      CRAFTFLEET_RETURN_IF_ERROR(Show());
      const bool due = AwaitKey(shown + (game_->ended() ? kEndedStays : absl::Seconds(1 / state_.speed)));
      if (!due && !state_.start.has_value() && !state_.step_once) continue;
      CRAFTFLEET_RETURN_IF_ERROR(Advance());
      shown = clock_->Now();
    }
    return absl::OkStatus();
  }

 private:
  absl::Status Show() {
    std::optional<AttentionChoice> attention;
    if (state_.attention) attention = options_.attention.value_or(AttentionChoice());
    absl::StatusOr<View> view = DrawMoment(agent_.title, screen_->Room(), attention, game_.get());
    if (absl::IsInvalidArgument(view.status()) && !options_.attention.has_value()) {
      state_.attention = false;  // the key was pressed for an agent without attention
      view = DrawMoment(agent_.title, screen_->Room(), std::nullopt, game_.get());
    }
    CRAFTFLEET_RETURN_IF_ERROR(view.status());
    if (state_.help) view->lines = KeyHelp();
    if (state_.paused) view->lines[0].text = "PAUSED " + view->lines[0].text;
    return screen_->Show(*view);
  }

  // Waits until `due` or the next key, and handles the key. Returns whether it is due. While paused there is no due
  // time.
  bool AwaitKey(absl::Time due) {
    while (!stop_) {
      const bool waits = state_.paused || state_.help;
      const absl::Duration left = due - clock_->Now();
      if (!waits && left <= absl::ZeroDuration()) return true;
      const Key key = screen_->ReadKey(waits ? kLongestWait : std::min(left, kLongestWait));
      if (key == kNoKey) continue;
      HandleWatchKey(key, game_->world().episode(), &state_);
      return false;
    }
    return false;
  }

  // Plays a step, or begins the episode that was asked for or follows an ended one.
  absl::Status Advance() {
    if (game_->ended() && !state_.start.has_value()) state_.start = game_->world().episode() + 1;
    state_.step_once = false;
    if (!state_.start.has_value()) return game_->Step();
    CRAFTFLEET_ASSIGN_OR_RETURN(agent_, options_.agent());
    return game_->Start(agent_.policy, *std::exchange(state_.start, std::nullopt));
  }

  const WatchOptions& options_;
  const std::atomic<bool>& stop_;
  Clock* const clock_;
  Screen* const screen_;
  WatchState state_;
  WatchedAgent agent_;
  std::unique_ptr<AgentGame> game_;
};

}  // namespace

void HandleWatchKey(Key key, int64_t episode, WatchState* state) {
  switch (key) {
    case ' ':
      state->paused = !state->paused;
      break;
    case '.':
      state->paused = true;
      state->step_once = true;
      break;
    case '+':
    case '=':
    case kUpKey:
      state->speed = std::min(2 * state->speed, kFastest);
      break;
    case '-':
    case kDownKey:
      state->speed = std::max(state->speed / 2, kSlowest);
      break;
    case 'n':
    case kRightKey:
      state->start = episode + 1;
      break;
    case 'b':
    case kLeftKey:
      state->start = std::max<int64_t>(episode - 1, 1);
      break;
    case 'r':
      state->start = episode;
      break;
    case 'a':
      state->attention = !state->attention;
      break;
    case 'h':
      state->help = !state->help;
      break;
    case 'q':
    case kEscapeKey:
    case kCloseKey:
      state->quit = true;
      break;
    default:
      break;
  }
}

absl::Status WatchOnScreen(const WatchOptions& options, const AgentGame::Options& game_options,
                           const std::atomic<bool>& stop, Clock* clock, Screen* screen) {
  return Watching(options, stop, clock, screen).Run(game_options);
}

}  // namespace craftfleet
