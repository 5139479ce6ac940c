#include "deploy/cli/screen/game_text.h"

#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/strings/str_replace.h>

namespace craftfleet {

std::string Words(absl::string_view name) { return absl::StrReplaceAll(name, {{"_", " "}}); }

TextLine NeedsLine(const World& world) {
  const Player& player = world.player();
  return {absl::StrFormat("health %d food %d drink %d energy %d", player.health(), player.item(Item::kFood),
                          player.item(Item::kDrink), player.item(Item::kEnergy)),
          player.health() <= 3 ? TextLine::Style::kBad : TextLine::Style::kPlain};
}

std::vector<TextLine> InventoryLines(const World& world, size_t width) {
  std::vector<TextLine> lines;
  for (int i = static_cast<int>(Item::kSapling); i < kNumItems; ++i) {
    const int amount = world.player().inventory[i];
    if (amount == 0) continue;
    const std::string item = absl::StrCat(amount, " ", Words(kItemNames[i]));
    if (lines.empty() || lines.back().text.size() + 2 + item.size() > width) {
      lines.push_back({item});
    } else {
      absl::StrAppend(&lines.back().text, ", ", item);
    }
  }
  return lines;
}

void RecentEvents::Add(const World& world, const StepOutcome& outcome) {
  const auto add = [this, &world](absl::string_view text, TextLine::Style style) {
    lines_.push_back({absl::StrFormat("%5d %s", world.step(), text), style});
    if (lines_.size() > most_) lines_.pop_front();
  };
  for (int i = 0; i < kNumAchievements; ++i) {
    if ((outcome.unlocked >> i & 1) != 0) add(absl::StrCat("+1 ", Words(kAchievementNames[i])), TextLine::Style::kGood);
  }
  const int health = world.player().health();
  if (health < health_) add(absl::StrCat(health - health_, " health"), TextLine::Style::kBad);
  health_ = health;
  if (outcome.end == StepEnd::kTerminated) add("died", TextLine::Style::kBad);
  if (outcome.end == StepEnd::kTruncated) add("time is up", TextLine::Style::kTitle);
}

void RecentEvents::Clear() {
  lines_.clear();
  health_ = 9;
}

}  // namespace craftfleet
