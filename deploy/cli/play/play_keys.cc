#include "deploy/cli/play/play_keys.h"

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

}  // namespace craftfleet
