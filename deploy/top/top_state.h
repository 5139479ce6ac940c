// What a person has chosen to see in `craftfleet top`.

#ifndef CRAFTFLEET_DEPLOY_TOP_TOP_STATE_H_
#define CRAFTFLEET_DEPLOY_TOP_TOP_STATE_H_

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
  int scroll = 0;  // workers above the screen's first one
  bool quit = false;
};

// Changes `state` by the keys in `bytes`, as a terminal sends them; unknown ones are passed over. `page` is how many
// workers a screen shows.
void HandleKeys(absl::string_view bytes, int page, TopState* state);

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_TOP_TOP_STATE_H_
