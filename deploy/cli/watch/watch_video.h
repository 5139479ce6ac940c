// Episodes as a video of what `craftfleet watch` shows.

#ifndef CRAFTFLEET_DEPLOY_CLI_WATCH_WATCH_VIDEO_H_
#define CRAFTFLEET_DEPLOY_CLI_WATCH_WATCH_VIDEO_H_

#include <atomic>
#include <functional>
#include <optional>
#include <string>

#include <absl/status/status.h>

#include "common/agent/attention_map.h"
#include "deploy/cli/watch/agent_game.h"

namespace craftfleet {

struct WatchVideoOptions {
  std::string path;   // of the MP4 file
  int size = 512;     // pixels, width and height of the game's picture
  std::string title;  // of the agent
  std::optional<AttentionChoice> attention;
  std::function<void(int64_t steps)> on_step;  // progress; may be null
};

// Plays the episode of `game` to its end. If `stop` becomes true, the video ends there.
//   Codes of VideoFile, AgentGame and DrawMoment.
absl::Status WriteWatchVideo(const WatchVideoOptions& options, const std::atomic<bool>& stop, AgentGame* game);

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_CLI_WATCH_WATCH_VIDEO_H_
