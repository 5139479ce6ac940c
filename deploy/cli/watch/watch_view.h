// What `craftfleet watch` shows at a moment.

#pragma once

#include <optional>
#include <string>
#include <vector>

#include <absl/status/statusor.h>

#include "common/agent/attention_map.h"
#include "deploy/cli/screen/screen.h"
#include "deploy/cli/watch/agent_game.h"

namespace craftfleet {

// The state of the game, and what the policy makes of it: at most 28 lines, with a bar for each action's probability.
// `title` names the agent; each of its parts, joined by ", ", is a line.
std::vector<TextLine> DescribeMoment(const std::string& title, const AgentGame& game);

// Picture and text. With `attention`, the picture is darkened except where the agent looks.
//   Errors as AgentGame::Attention and Choose.
absl::StatusOr<View> DrawMoment(const std::string& title, const PictureRoom& room,
                                const std::optional<AttentionChoice>& attention, AgentGame* game);

}  // namespace craftfleet
