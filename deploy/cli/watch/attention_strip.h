// The paper's figures of attention: a row of game pictures, and below it what the agent looks at.

#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include <absl/status/statusor.h>

#include "actor/recording/picture.h"
#include "common/agent/attention_map.h"
#include "deploy/cli/watch/agent_game.h"

namespace craftfleet {

inline constexpr int kStripPicture = 180;  // pixels, width and height of a picture; whole cells of the default view
inline constexpr int kStripGap = 6;        // pixels between pictures
inline constexpr int kStripLabel = 22;     // pixels, height of the labels at the bottom

struct StripColumn {
  int64_t step = 0;            // of the episode
  std::string picture;         // uint8[kStripPicture,kStripPicture,3]
  PatchGrid patches;           // of a frame
  std::vector<float> weights;  // [patches.count()]
};

struct StripPicture {
  int width = 0;       // pixels
  int height = 0;      // pixels
  std::string pixels;  // uint8[height,width,3]
};

// Two rows of pictures with the steps below them; each attention is as bright as its own highest weight allows.
// `columns` is not empty; the frames of all have the same size.
StripPicture DrawStrip(const std::vector<StripColumn>& columns);

// The most interesting steps of an episode of `length` steps, ascending, `count` of them or all if there are fewer:
// those before an achievement (`unlocks`, ascending), the first ones if there are too many; the rest is spread evenly.
std::vector<int64_t> ChooseSteps(const std::vector<int64_t>& unlocks, int64_t length, int count);

struct EpisodeOutline {
  std::vector<int64_t> unlocks;  // the steps before an achievement was unlocked, ascending
  int64_t length = 0;            // steps
};

// Called after each step, with the steps of the episode so far.
using StepListener = std::function<void(int64_t steps)>;

// Plays an episode, which has just begun, to its end.
//   Errors as AgentGame::Step. Cancelled: `stop` became true.
absl::StatusOr<EpisodeOutline> PlayOutline(const std::atomic<bool>& stop, const StepListener& on_step, AgentGame* game);

// Plays an episode, which has just begun, up to the last of `steps` (ascending) and takes the columns there. Steps
// after the end are left out.
//   Errors as AgentGame::Attention and Choose. Cancelled: `stop` became true.
absl::StatusOr<std::vector<StripColumn>> TakeColumns(const std::vector<int64_t>& steps, const AttentionChoice& choice,
                                                     const std::atomic<bool>& stop, const StepListener& on_step,
                                                     AgentGame* game);

}  // namespace craftfleet
