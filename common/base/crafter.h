// Crafter's vocabulary: actions, items and achievements with their names, in Crafter's order. Shared by every process.
// Source: envserver/world/RULES.md, section 1.

#pragma once

#include <algorithm>
#include <array>
#include <cstdint>

#include <absl/strings/string_view.h>

namespace craftfleet {

// The actions of an agent, 0..16; the same numbers from policy to loss.
enum class Action : uint8_t {
  kNoop,
  kMoveLeft,
  kMoveRight,
  kMoveUp,
  kMoveDown,
  kDo,
  kSleep,
  kPlaceStone,
  kPlaceTable,
  kPlaceFurnace,
  kPlacePlant,
  kMakeWoodPickaxe,
  kMakeStonePickaxe,
  kMakeIronPickaxe,
  kMakeWoodSword,
  kMakeStoneSword,
  kMakeIronSword,
};
inline constexpr int kNumActions = 17;
inline constexpr int kNumItems = 16;
inline constexpr int kNumAchievements = 22;
inline constexpr int kWorldSize = 64;         // cells, width and height
inline constexpr int kEpisodeLength = 10000;  // steps after which an episode is truncated, by default

// Times that each achievement was unlocked in an episode.
using AchievementCounts = std::array<int32_t, kNumAchievements>;

// The number of achievements that were unlocked at least once.
inline int CountUnlocked(const AchievementCounts& counts) {
  return static_cast<int>(std::count_if(counts.begin(), counts.end(), [](int32_t count) { return count > 0; }));
}

// Range of a step's reward: 0.1 for each point of health (0..9) gained or lost, and 1 if the step unlocks achievements.
// Source: envserver/world/RULES.md, section 5.
inline constexpr double kMinStepReward = -0.9;
inline constexpr double kMaxStepReward = 1.9;
// Whether a step with this reward unlocked an achievement: then it is at least 0.2 for a player that lives, else at
// most 0.1, as health returns by one point. Of the step in which the player dies it says nothing.
constexpr bool UnlocksAchievement(float reward) { return reward > 0.15F; }
// Range of an episode's reward: it begins with full health, so the changes of health add up to -0.9..0, and each
// achievement is rewarded at most once.
inline constexpr double kMinEpisodeReward = -0.9;
inline constexpr double kMaxEpisodeReward = 22;

inline constexpr std::array<absl::string_view, kNumActions> kActionNames = {"noop",
                                                                            "move_left",
                                                                            "move_right",
                                                                            "move_up",
                                                                            "move_down",
                                                                            "do",
                                                                            "sleep",
                                                                            "place_stone",
                                                                            "place_table",
                                                                            "place_furnace",
                                                                            "place_plant",
                                                                            "make_wood_pickaxe",
                                                                            "make_stone_pickaxe",
                                                                            "make_iron_pickaxe",
                                                                            "make_wood_sword",
                                                                            "make_stone_sword",
                                                                            "make_iron_sword"};

enum class Item : uint8_t {
  kHealth,
  kFood,
  kDrink,
  kEnergy,
  kSapling,
  kWood,
  kStone,
  kCoal,
  kIron,
  kDiamond,
  kWoodPickaxe,
  kStonePickaxe,
  kIronPickaxe,
  kWoodSword,
  kStoneSword,
  kIronSword,
};

inline constexpr std::array<absl::string_view, kNumItems> kItemNames = {
    "health", "food",    "drink",        "energy",        "sapling",      "wood",       "stone",       "coal",
    "iron",   "diamond", "wood_pickaxe", "stone_pickaxe", "iron_pickaxe", "wood_sword", "stone_sword", "iron_sword"};

// Alphabetical, as Crafter lists them.
enum class Achievement : uint8_t {
  kCollectCoal,
  kCollectDiamond,
  kCollectDrink,
  kCollectIron,
  kCollectSapling,
  kCollectStone,
  kCollectWood,
  kDefeatSkeleton,
  kDefeatZombie,
  kEatCow,
  kEatPlant,
  kMakeIronPickaxe,
  kMakeIronSword,
  kMakeStonePickaxe,
  kMakeStoneSword,
  kMakeWoodPickaxe,
  kMakeWoodSword,
  kPlaceFurnace,
  kPlacePlant,
  kPlaceStone,
  kPlaceTable,
  kWakeUp,
};

inline constexpr std::array<absl::string_view, kNumAchievements> kAchievementNames = {
    "collect_coal",     "collect_diamond",
    "collect_drink",    "collect_iron",
    "collect_sapling",  "collect_stone",
    "collect_wood",     "defeat_skeleton",
    "defeat_zombie",    "eat_cow",
    "eat_plant",        "make_iron_pickaxe",
    "make_iron_sword",  "make_stone_pickaxe",
    "make_stone_sword", "make_wood_pickaxe",
    "make_wood_sword",  "place_furnace",
    "place_plant",      "place_stone",
    "place_table",      "wake_up"};

}  // namespace craftfleet
