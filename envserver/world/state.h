// Everything that a step of the game can change.

#pragma once

#include <array>
#include <cstdint>

#include "common/base/crafter.h"
#include "envserver/world/board.h"
#include "envserver/world/options.h"
#include "envserver/world/random_stream.h"

namespace craftfleet {

inline constexpr int kMaxItem = 9;

// The player's inventory and needs; its position is that of objects()[0].
struct Player {
  bool sleeping = false;
  std::array<int8_t, kNumItems> inventory{};  // 0..9
  AchievementCounts achievements{};           // in this episode
  double hunger = 0;
  double thirst = 0;
  double fatigue = 0;
  double recover = 0;
  int last_health = kMaxItem;  // at the end of its previous update

  int item(Item which) const { return inventory[static_cast<int>(which)]; }
  int8_t& item(Item which) { return inventory[static_cast<int>(which)]; }
  int health() const { return item(Item::kHealth); }
};

struct WorldState {
  explicit WorldState(const WorldOptions& world_options)
      : options(world_options), board(world_options.width, world_options.height) {}

  WorldOptions options;  // constant after construction
  int64_t seed = 0;
  int64_t episode = 0;  // counts from 1; 0 before the first reset
  int64_t step = 0;     // of this episode
  double daylight = 0;
  double episode_reward = 0;
  int last_health = kMaxItem;  // at the previous step's end
  Player player;
  Board board;
  RandomStream random;
};

}  // namespace craftfleet
