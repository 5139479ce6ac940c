// Maps the things on the map to textures. A sprite is a material, creature, player, arrow or plant in one of its
// variants; sprites are numbered without gaps, so that a renderer can keep them in an array.

#pragma once

#include <string>

#include "envserver/world/board.h"
#include "envserver/world/options.h"
#include "envserver/world/types.h"

namespace craftfleet {

using Sprite = int;  // 0..kNumSprites-1

inline constexpr int kNumSpriteKinds = 26;
inline constexpr int kLooksPerKind = kNumVariants + 1;  // without variant, then variant 0..3
inline constexpr int kNumSprites = kNumSpriteKinds * kLooksPerKind;

// `material` is not kNone.
inline Sprite SpriteOf(Material material, Variant variant) {
  return (static_cast<int>(material) - 1) * kLooksPerKind + variant + 1;
}
// `sleeping` is the player's state and matters for the player only.
Sprite SpriteOf(const Object& object, bool sleeping);

// Whether it is a material's, not that of a creature, player, arrow or plant.
bool IsMaterial(Sprite sprite);

// The texture's name: of the material; player-left, -right, -up, -down by facing, or player-sleep; cow, zombie,
// skeleton; arrow-left, ...; plant or plant-ripe; with the variant's digit, if there is one: "tree2".
std::string SpriteName(Sprite sprite);
// Whether it is an appearance variant, "tree2", of a plain sprite.
bool IsVariant(Sprite sprite);

// Whether a world with these options can show it.
bool IsPossible(const WorldOptions& options, Sprite sprite);

}  // namespace craftfleet
