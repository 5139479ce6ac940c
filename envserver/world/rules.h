// Shared by the updates of all objects: walkable materials, moving, distance.
// Source: RULES.md, sections 1 and 4.

#pragma once

#include <cstdint>
#include <cstdlib>
#include <initializer_list>

#include "envserver/world/board.h"
#include "envserver/world/types.h"

namespace craftfleet {

// A set of materials; kNone, the outside, is in none of those below.
class MaterialSet {
 public:
  constexpr MaterialSet(std::initializer_list<Material> materials) {
    for (const Material material : materials) bits_ |= Bit(material);
  }
  constexpr bool Contains(Material material) const { return (bits_ & Bit(material)) != 0; }

 private:
  static constexpr uint32_t Bit(Material material) { return 1u << static_cast<int>(material); }
  uint32_t bits_ = 0;
};

inline constexpr MaterialSet kCreatureWalks = {Material::kGrass, Material::kPath, Material::kSand};
inline constexpr MaterialSet kPlayerWalks = {Material::kGrass, Material::kPath, Material::kSand, Material::kLava};
inline constexpr MaterialSet kArrowFlies = {Material::kGrass, Material::kPath, Material::kSand, Material::kWater,
                                            Material::kLava};

inline constexpr Position kDirections[] = {{-1, 0}, {1, 0}, {0, -1}, {0, 1}};

inline int Distance(Position a, Position b) { return std::abs(a.x - b.x) + std::abs(a.y - b.y); }

inline bool IsFree(const Board& board, Position p, MaterialSet walkable) {
  return board.Inside(p) && board.cell(p).object == 0 && walkable.Contains(board.cell(p).material);
}

// Moves the object one step if the target is free. Returns whether it was, for a removed object too.
inline bool TryMove(Board* board, int index, Position direction, MaterialSet walkable) {
  const Position target = board->object(index).position + direction;
  if (!IsFree(*board, target, walkable)) return false;
  board->Move(index, target);
  return true;
}

}  // namespace craftfleet
