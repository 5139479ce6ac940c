#include "deploy/cli/play/play_loop.h"

#include <algorithm>
#include <optional>
#include <utility>
#include <vector>

#include "common/base/status_macros.h"
#include "deploy/cli/play/play_keys.h"
#include "deploy/cli/screen/game_pictures.h"

namespace craftfleet {
namespace {

constexpr absl::Duration kLongestWait = absl::Milliseconds(200);  // for a key; then `stop` is looked at

// What the keys pressed during a step ask for.
struct Wish {
  std::optional<Action> action;
  bool next_episode = false;
  bool toggle_help = false;
  bool quit = false;
};

absl::Status ShowGame(bool help, PlaySession* session, Screen* screen) {
  View view;
  view.width = PictureSize(screen->Room(), session->world().options().view_width);
  view.height = view.width;
  CRAFTFLEET_ASSIGN_OR_RETURN(view.picture, session->Picture(view.width));
  view.lines = help ? KeyHelp() : session->Panel();
  if (!help) {
    view.lines.push_back({""});
    view.lines.push_back({"h: keys, q: quit"});
  }
  return screen->Show(view);
}

// Reads keys until `due`, or until the next key that does more than act. Without a due time, until the first key.
Wish ReadWish(absl::Time due, const std::atomic<bool>& stop, Clock* clock, Screen* screen) {
  Wish wish;
  while (!stop) {
    const absl::Duration left = due - clock->Now();
    if (left <= absl::ZeroDuration()) return wish;
    const Key key = screen->ReadKey(std::min(left, kLongestWait));
    if (key == kNoKey) continue;
    wish.quit = key == 'q' || key == kEscapeKey || key == kCloseKey;
    wish.next_episode = key == 'n';
    wish.toggle_help = key == 'h';
    if (wish.quit || wish.next_episode || wish.toggle_help) return wish;
    if (const auto action = ActionOfKey(key)) wish.action = action;
    if (wish.action.has_value() && due == absl::InfiniteFuture()) return wish;
  }
  return wish;
}

}  // namespace

absl::Status PlayOnScreen(absl::Duration step_time, const std::atomic<bool>& stop, Clock* clock, PlaySession* session,
                          Screen* screen) {
  bool help = false;
  while (!stop) {
    CRAFTFLEET_RETURN_IF_ERROR(ShowGame(help, session, screen));
    const bool waits = help || session->ended();
    const Wish wish = ReadWish(waits ? absl::InfiniteFuture() : clock->Now() + step_time, stop, clock, screen);
    if (wish.quit) return absl::OkStatus();
    if (wish.toggle_help || (help && wish.action.has_value())) {
      help = !help;
    } else if (wish.next_episode) {
      CRAFTFLEET_RETURN_IF_ERROR(session->StartNextEpisode());
    } else if (!stop) {
      CRAFTFLEET_RETURN_IF_ERROR(session->Step(wish.action.value_or(Action::kNoop)));
    }
  }
  return absl::OkStatus();
}

}  // namespace craftfleet
