#include "deploy/cli/watch/watch_view.h"

#include <utility>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/strings/str_split.h>

#include "actor/recording/picture.h"
#include "common/base/status_macros.h"

namespace craftfleet {
namespace {

TextLine ActionLine(int action, const AgentGame::Decision& decision) {
  const bool chosen = static_cast<int>(decision.action) == action;
  return {absl::StrCat(chosen ? "> " : "  ", kActionNames[action]),
          chosen ? TextLine::Style::kGood : TextLine::Style::kPlain, decision.odds.probs[action]};
}

}  // namespace

std::vector<TextLine> DescribeMoment(const std::string& title, const AgentGame& game) {
  const World& world = game.world();
  std::vector<TextLine> lines;
  for (const absl::string_view part : absl::StrSplit(title, ", ")) {
    lines.push_back({std::string(part), TextLine::Style::kTitle});
  }
  lines.push_back({absl::StrFormat("seed %d, episode %d, step %d", world.seed(), world.episode(), world.step())});
  lines.push_back({absl::StrFormat("reward %.1f (%+.1f), value %.2f", world.episode_reward(), game.outcome().reward,
                                   game.decision().value)});
  lines.push_back(NeedsLine(world));
  for (int action = 0; action < kNumActions; ++action) lines.push_back(ActionLine(action, game.decision()));
  lines.push_back(game.events().lines().empty() ? TextLine() : game.events().lines().back());
  // At the end, because their number changes.
  for (TextLine& line : InventoryLines(world, kTextColumns)) lines.push_back(std::move(line));
  return lines;
}

absl::StatusOr<View> DrawMoment(const std::string& title, const PictureRoom& room,
                                const std::optional<AttentionChoice>& attention, AgentGame* game) {
  View view;
  view.width = PictureSize(room, game->world().options().view_width);
  view.height = view.width;
  CRAFTFLEET_ASSIGN_OR_RETURN(view.picture, game->Picture(view.width));
  if (attention.has_value()) {
    CRAFTFLEET_ASSIGN_OR_RETURN(const AttentionMap map, game->Attention());
    CRAFTFLEET_ASSIGN_OR_RETURN(const std::vector<float> weights, Choose(map, *attention));
    view.picture =
        OverlayAttention(view.picture, view.width, LightToHighest(map.patches, weights).brightness, game->frame_size());
  }
  view.lines = DescribeMoment(title, *game);
  return view;
}

}  // namespace craftfleet
