// One episode as rows, for a NumPy file in the format of Crafter's own episode recorder.

#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "actor/episode_observer.h"
#include "actor/recording/npz.h"
#include "common/base/types.h"

namespace craftfleet {

// The first row is the reset: its image, and zeros. Each further row is a step: action, reward, and the game after it.
// Thread-compatible.
// Source: what crafter/recorder.py of the Python package writes (version 1.8.3).
class EpisodeTable {
 public:
  // `frame_size`: pixels, width and height of the images.
  EpisodeTable(int frame_size, const Moment& first);

  void Add(const ObservedStep& step, const Moment& moment);

  // With T the number of steps: image uint8[T+1,H,W,3], action int64[T+1], reward float64, done bool, discount float64
  // (0 at a death, else 1), semantic uint8[T+1,64,64], player_pos int64[T+1,2], achievement_<name> int64 (so far in the
  // episode), ainventory_<item> int64.
  std::vector<NpyArray> Arrays() const;

 private:
  struct Row {
    Action action = Action::kNoop;
    double reward = 0;
    bool done = false;
    double discount = 0;
    std::array<int64_t, 2> player_pos{};
    AchievementCounts achievements{};
    std::array<int32_t, kNumItems> inventory{};
  };

  int frame_size_;
  std::string images_;      // uint8[rows,H,W,3]
  std::string semantics_;   // uint8[rows,64,64]
  std::vector<Row> table_;  // [rows]
};

}  // namespace craftfleet
