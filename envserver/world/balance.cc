#include "envserver/world/balance.h"

#include <cstdint>

#include "common/base/check.h"
#include "envserver/world/appearance.h"
#include "envserver/world/creatures.h"
#include "envserver/world/rules.h"

namespace craftfleet {
namespace {

struct BalanceRule {
  ObjectType type;
  Material on;
  int spawn_distance;
  int despawn_distance;
  double spawn_probability;
  double despawn_probability;
  int least_space;  // with fewer cells of the material, min is 0
  int min;          // creatures; below it one may spawn
  int max;          // creatures; above it one may despawn
};

// The `number`-th cell of the material in the chunk, x outer.
Position FindCell(const Board& board, const Chunk& chunk, Material material, uint32_t number) {
  for (int x = chunk.min.x; x < chunk.max.x; ++x) {
    for (int y = chunk.min.y; y < chunk.max.y; ++y) {
      if (board.cell({x, y}).material == material && number-- == 0) return {x, y};
    }
  }
  CRAFTFLEET_CHECK(false);  // the chunk's count was wrong
}

// The creature of the type in the chunk that was the first to enter it after the one with the rank `entered`, or -1.
int NextToEnter(const Board& board, int chunk, ObjectType type, int64_t entered) {
  int next = -1;
  for (size_t i = 0; i < board.objects().size(); ++i) {
    const Object& object = board.objects()[i];
    if (object.type != type || object.removed || object.entered <= entered) continue;
    if (board.ChunkIndex(object.position) != chunk) continue;
    if (next < 0 || object.entered < board.object(next).entered) next = static_cast<int>(i);
  }
  return next;
}

// The `number`-th creature of the type in the chunk in the order in which they entered it.
int FindCreature(const Board& board, int chunk, ObjectType type, uint32_t number) {
  int found = -1;
  int64_t entered = -1;
  for (uint32_t i = 0; i <= number; ++i) {  // each round finds the next one to have entered
    found = NextToEnter(board, chunk, type, entered);
    CRAFTFLEET_CHECK(found >= 0);  // the chunk's count was wrong
    entered = board.object(found).entered;
  }
  return found;
}

void Balance(const BalanceRule& rule, int chunk_index, WorldState* state) {
  Board& board = state->board;
  RandomStream& random = state->random;
  const Position player = board.object(0).position;
  const Chunk& chunk = board.chunk(chunk_index);
  const int creatures = chunk.objects[static_cast<int>(rule.type)];
  const int space = chunk.materials[static_cast<int>(rule.on)];
  if (creatures < (space < rule.least_space ? 0 : rule.min) && random.Uniform() < rule.spawn_probability) {
    const Position cell = FindCell(board, chunk, rule.on, random.Below(space));
    if (board.cell(cell).object == 0 && Distance(cell, player) >= rule.spawn_distance) {
      AddCreature(rule.type, cell, DrawVariant(state->options, rule.type, &random), &board);
    }
  } else if (creatures > rule.max && random.Uniform() < rule.despawn_probability) {
    const int creature = FindCreature(board, chunk_index, rule.type, random.Below(creatures));
    if (Distance(board.object(creature).position, player) >= rule.despawn_distance) board.Remove(creature);
  }
}

}  // namespace

void BalanceChunks(WorldState* state) {
  const int zombies = static_cast<int>(3.5 - 3 * state->daylight);
  const int most_cows = static_cast<int>(1.5 + state->daylight);
  const BalanceRule rules[] = {
      {ObjectType::kZombie, Material::kGrass, 6, 0, 0.3, 0.4, 50, zombies, zombies},
      {ObjectType::kSkeleton, Material::kPath, 7, 7, 0.1, 0.1, 6, 1, 2},
      {ObjectType::kCow, Material::kGrass, 5, 5, 0.01, 0.1, 30, 1, most_cows},
  };
  for (const int chunk : state->board.known_chunks()) {
    for (const BalanceRule& rule : rules) Balance(rule, chunk, state);
  }
}

}  // namespace craftfleet
