#include "deploy/cli/play/play_loop.h"

#include <algorithm>
#include <optional>
#include <utility>
#include <vector>

#include "common/base/status_macros.h"
#include "deploy/cli/screen/game_pictures.h"

namespace craftfleet {
namespace {

struct KeyAction {
  Key key;
  Action action;
};

constexpr KeyAction kKeyActions[] = {
    {'w', Action::kMoveUp},
    {'a', Action::kMoveLeft},
    {'s', Action::kMoveDown},
    {'d', Action::kMoveRight},
    {kUpKey, Action::kMoveUp},
    {kLeftKey, Action::kMoveLeft},
    {kDownKey, Action::kMoveDown},
    {kRightKey, Action::kMoveRight},
    {' ', Action::kDo},
    {kTabKey, Action::kSleep},
    {'z', Action::kSleep},  // some window systems keep Tab for themselves
    {'.', Action::kNoop},
    {'r', Action::kPlaceStone},
    {'t', Action::kPlaceTable},
    {'f', Action::kPlaceFurnace},
    {'p', Action::kPlacePlant},
    {'1', Action::kMakeWoodPickaxe},
    {'2', Action::kMakeStonePickaxe},
    {'3', Action::kMakeIronPickaxe},
    {'4', Action::kMakeWoodSword},
    {'5', Action::kMakeStoneSword},
    {'6', Action::kMakeIronSword},
};

constexpr absl::Duration kLongestWait = absl::Milliseconds(200);  // for a key; then `stop` is looked at

// What the keys pressed during a step ask for.
struct KeyInput {
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
KeyInput ReadKeys(absl::Time due, const std::atomic<bool>& stop, Clock* clock, Screen* screen) {
  KeyInput input;
  while (!stop) {
    const absl::Duration left = due - clock->Now();
    if (left <= absl::ZeroDuration()) return input;
    const Key key = screen->ReadKey(std::min(left, kLongestWait));
    if (key == kNoKey) continue;
    input.quit = key == 'q' || key == kEscapeKey || key == kCloseKey;
    input.next_episode = key == 'n';
    input.toggle_help = key == 'h';
    if (input.quit || input.next_episode || input.toggle_help) return input;
    if (const auto action = ActionOfKey(key)) input.action = action;
    if (input.action.has_value() && due == absl::InfiniteFuture()) return input;
  }
  return input;
}

}  // namespace

std::optional<Action> ActionOfKey(Key key) {
  for (const KeyAction& entry : kKeyActions) {
    if (entry.key == key) return entry.action;
  }
  return std::nullopt;
}

std::vector<TextLine> KeyHelp() {
  return {
      {"Keys", TextLine::Style::kTitle},
      {"wasd   walk, turn; also arrows"},
      {"space  collect, drink, eat, fight"},
      {"tab z  sleep"},
      {".      wait a step"},
      {"r      place a stone"},
      {"t      place a table"},
      {"f      place a furnace"},
      {"p      plant a sapling"},
      {"1 2 3  make a pickaxe of wood,"},
      {"       stone, iron"},
      {"4 5 6  make a sword of wood,"},
      {"       stone, iron"},
      {"n      next episode"},
      {"h      this help"},
      {"q, esc quit"},
  };
}

absl::Status PlayOnScreen(absl::Duration step_time, const std::atomic<bool>& stop, Clock* clock, PlaySession* session,
                          Screen* screen) {
  bool help = false;
  while (!stop) {
    CRAFTFLEET_RETURN_IF_ERROR(ShowGame(help, session, screen));
    const bool waits = help || session->ended();
    const KeyInput input = ReadKeys(waits ? absl::InfiniteFuture() : clock->Now() + step_time, stop, clock, screen);
    if (input.quit) return absl::OkStatus();
    if (input.toggle_help || (help && input.action.has_value())) {
      help = !help;
    } else if (input.next_episode) {
      CRAFTFLEET_RETURN_IF_ERROR(session->StartNextEpisode());
    } else if (!stop) {
      CRAFTFLEET_RETURN_IF_ERROR(session->Step(input.action.value_or(Action::kNoop)));
    }
  }
  return absl::OkStatus();
}

}  // namespace craftfleet
