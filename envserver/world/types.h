// Materials, object types and positions.
// Source: RULES.md, section 1.

#pragma once

#include <array>
#include <cstdint>
#include <string>

#include <absl/strings/string_view.h>

namespace craftfleet {

// Ids of Crafter's semantic view; kNone is outside the world.
enum class Material : uint8_t {
  kNone,
  kWater,
  kGrass,
  kStone,
  kPath,
  kSand,
  kTree,
  kLava,
  kCoal,
  kIron,
  kDiamond,
  kTable,
  kFurnace,
};
inline constexpr int kNumMaterials = 13;  // with kNone

inline constexpr std::array<absl::string_view, kNumMaterials> kMaterialNames = {
    "none", "water", "grass", "stone", "path", "sand", "tree", "lava", "coal", "iron", "diamond", "table", "furnace"};

// Numbered as in the golden traces.
enum class ObjectType : uint8_t { kNone, kPlayer, kCow, kZombie, kSkeleton, kArrow, kPlant };

// Appearance variant of a material's cell or of a creature (CrafterOOD): kNoVariant draws the plain texture, k draws
// "<name><k>".
using Variant = int8_t;
inline constexpr Variant kNoVariant = -1;

// (x, y): x to the right, y down, (0, 0) top left. Also used for directions.
struct Position {
  int x = 0;
  int y = 0;
  friend bool operator==(Position a, Position b) { return a.x == b.x && a.y == b.y; }
  friend bool operator!=(Position a, Position b) { return !(a == b); }
  friend Position operator+(Position a, Position b) { return {a.x + b.x, a.y + b.y}; }
};

}  // namespace craftfleet
