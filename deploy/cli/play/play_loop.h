// The loop of `craftfleet play`: keys to actions, games to a screen.

#pragma once

#include <atomic>
#include <optional>
#include <vector>

#include <absl/status/status.h>
#include <absl/time/time.h>

#include "common/base/clock.h"
#include "common/base/crafter.h"
#include "deploy/cli/play/play_session.h"
#include "deploy/cli/screen/screen.h"

namespace craftfleet {

// The action of a key, as in Crafter's own window and more; nullopt if it has none.
std::optional<Action> ActionOfKey(Key key);

// The help page: every key with its effect.
std::vector<TextLine> KeyHelp();

// Plays on `screen` until the player quits or `stop` becomes true. A step takes `step_time`, after which the last
// action key counts, or no key; with absl::InfiniteDuration() the game waits for an action key.
absl::Status PlayOnScreen(absl::Duration step_time, const std::atomic<bool>& stop, Clock* clock, PlaySession* session,
                          Screen* screen);

}  // namespace craftfleet
