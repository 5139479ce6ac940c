// The user's choices in `craftfleet top`: sort column, scrolling, pause, help.

#ifndef CRAFTFLEET_DEPLOY_CLI_TOP_TOP_STATE_H_
#define CRAFTFLEET_DEPLOY_CLI_TOP_TOP_STATE_H_

#include <optional>

#include <absl/strings/string_view.h>

namespace craftfleet {

// Columns by which workers can be sorted.
enum class TopColumn { kRole, kName, kState, kSteps, kLanes, kLag, kMemory, kErrors, kSeen };
inline constexpr int kNumTopColumns = 9;

// "role", "name", "state", "steps", "lanes", "lag", "mem", "err", "seen".
absl::string_view TopColumnName(TopColumn column);
std::optional<TopColumn> TopColumnByName(absl::string_view name);

struct TopState {
  TopColumn sort = TopColumn::kRole;
  bool reverse = false;
  bool paused = false;
  bool help = false;
  int scroll = 0;  // workers scrolled past, above the first one on screen
  bool quit = false;
};

// Applies the keys in `bytes`, as a terminal sends them, to `state`; unknown keys are ignored. `page` is the number of
// workers on a screen.
void HandleKeys(absl::string_view bytes, int page, TopState* state);

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_CLI_TOP_TOP_STATE_H_
