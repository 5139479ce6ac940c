// The state of a game as text, for people.

#pragma once

#include <deque>
#include <string>
#include <vector>

#include <absl/strings/string_view.h>

#include "deploy/cli/screen/screen.h"
#include "envserver/world/world.h"

namespace craftfleet {

// The name of an item or achievement in words: "wood pickaxe".
std::string Words(absl::string_view name);

// "health 9 food 8 drink 7 energy 6".
TextLine NeedsLine(const World& world);

// The items that the player has, in lines of at most `width` characters; none without items.
std::vector<TextLine> InventoryLines(const World& world, size_t width);

// What happened in an episode: achievements, lost health, the end. Keeps the latest events. Thread-compatible.
class RecentEvents {
 public:
  explicit RecentEvents(size_t most) : most_(most) {}

  // `world` after a step with `outcome`.
  void Add(const World& world, const StepOutcome& outcome);
  // A new episode begins.
  void Clear();

  const std::deque<TextLine>& lines() const { return lines_; }  // the latest last

 private:
  const size_t most_;
  std::deque<TextLine> lines_;
  int health_ = 9;  // after the last step
};

}  // namespace craftfleet
