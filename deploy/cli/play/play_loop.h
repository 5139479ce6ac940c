// The loop of `craftfleet play`: keys to actions, games to a screen.

#ifndef CRAFTFLEET_DEPLOY_CLI_PLAY_PLAY_LOOP_H_
#define CRAFTFLEET_DEPLOY_CLI_PLAY_PLAY_LOOP_H_

#include <atomic>

#include <absl/status/status.h>
#include <absl/time/time.h>

#include "common/base/clock.h"
#include "deploy/cli/play/play_session.h"
#include "deploy/cli/screen/screen.h"

namespace craftfleet {

// Plays on `screen` until the player quits or `stop` becomes true. A step takes `step_time`, after which the last
// action key counts, or no key; with absl::InfiniteDuration() the game waits for an action key.
absl::Status PlayOnScreen(absl::Duration step_time, const std::atomic<bool>& stop, Clock* clock, PlaySession* session,
                          Screen* screen);

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_CLI_PLAY_PLAY_LOOP_H_
