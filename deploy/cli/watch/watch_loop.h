// The loop of `craftfleet watch`: an agent plays on a screen, keys change the speed.

#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>

#include <absl/status/status.h>
#include <absl/status/statusor.h>

#include "common/agent/attention_map.h"
#include "common/agent/policy.h"
#include "common/base/clock.h"
#include "deploy/cli/screen/screen.h"
#include "deploy/cli/watch/agent_game.h"

namespace craftfleet {

// The agent of an episode.
struct WatchedAgent {
  std::string title;  // such as "ppo_cnn, 100,352 steps"
  std::shared_ptr<const Policy> policy;
};

struct WatchOptions {
  double speed = 5;                          // steps a second at first
  int64_t episode = 1;                       // the first one
  std::optional<AttentionChoice> attention;  // shown from the beginning; nullopt: the key shows the mean
  // The agent of the next episode; called before each.
  std::function<absl::StatusOr<WatchedAgent>()> agent;
};

// The current choices of the person who watches. Keys change them (HandleWatchKey).
struct WatchState {
  double speed = 5;  // steps a second, 0.25..256
  bool paused = false;
  bool help = false;
  bool attention = false;
  bool step_once = false;        // play one step although paused
  std::optional<int64_t> start;  // begin this episode now
  bool quit = false;
};

// `episode`: the current one.
void HandleWatchKey(Key key, int64_t episode, WatchState* state);

// Shows episodes, one after the other, until `stop` or the quit key. An ended episode stays for two seconds.
//   Errors of options.agent, AgentGame and Screen.
absl::Status WatchOnScreen(const WatchOptions& options, const AgentGame::Options& game_options,
                           const std::atomic<bool>& stop, Clock* clock, Screen* screen);

}  // namespace craftfleet
