// Crafter's vocabulary: actions, items and achievements with their names, in Crafter's order. Shared by every process.
// Source: Crafter's rules, the tables.

#ifndef CRAFTFLEET_COMMON_CRAFTER_H_
#define CRAFTFLEET_COMMON_CRAFTER_H_

#include <array>
#include <cstdint>

#include <absl/strings/string_view.h>

namespace craftfleet {

// What an agent can do; 0..16, the same number from policy to loss.
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
inline constexpr int kEpisodeLength = 10000;  // steps after which an episode is truncated, where nothing else is said

// What a step can give: a tenth for each point of health that it adds or takes, of which there are 0..9, and 1 if it
// unlocks achievements. Source: Crafter's rules.
inline constexpr double kMinStepReward = -0.9;
inline constexpr double kMaxStepReward = 1.9;
// What an episode can give: it begins with full health, so the changes of health add up to -0.9..0, and each of the
// achievements is unlocked once at most.
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

#endif  // CRAFTFLEET_COMMON_CRAFTER_H_
