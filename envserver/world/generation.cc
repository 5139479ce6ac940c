#include "envserver/world/generation.h"

#include <cmath>
#include <cstdint>

#include <absl/container/fixed_array.h>

#include "envserver/world/appearance.h"
#include "envserver/world/creatures.h"
#include "envserver/world/rules.h"
#include "envserver/world/simplex_noise.h"
#include "envserver/world/terrain.h"

namespace craftfleet {
namespace {

Material MountainMaterial(uint16_t traits, const NumberThresholds& numbers, RandomStream* random) {
  if ((traits & (kCave | kTunnel)) != 0) return Material::kPath;
  if ((traits & kCoalVein) != 0 && random->Uniform() > numbers.coal) return Material::kCoal;
  if ((traits & kIronVein) != 0 && random->Uniform() > 0.75) return Material::kIron;
  if ((traits & kHigh) != 0 && random->Uniform() > 0.994) return Material::kDiamond;
  if ((traits & kLavaField) != 0) return Material::kLava;
  return Material::kStone;
}

Material DrawMaterial(uint16_t traits, const NumberThresholds& numbers, RandomStream* random) {
  if ((traits & kStart) != 0) return Material::kGrass;
  if ((traits & kMountain) != 0) return MountainMaterial(traits, numbers, random);
  if ((traits & kSandy) != 0) return Material::kSand;
  if ((traits & kSea) != 0) return Material::kWater;
  if ((traits & kForest) != 0 && random->Uniform() > numbers.tree) return Material::kTree;
  return Material::kGrass;
}

ObjectType DrawCreature(const WorldState& state, Position p, uint16_t traits, RandomStream* random) {
  const Material material = state.board.cell(p).material;
  const NumberThresholds& numbers = state.options.numbers;
  const Position player = state.board.object(0).position;
  const int dx = p.x - player.x;
  const int dy = p.y - player.y;
  const int squared_distance = dx * dx + dy * dy;
  if (squared_distance > 3 * 3 && material == Material::kGrass && random->Uniform() > numbers.cow) {
    return ObjectType::kCow;
  }
  if (squared_distance > 10 * 10 && random->Uniform() > numbers.zombie) return ObjectType::kZombie;
  if ((traits & kTunnel) != 0 && random->Uniform() > numbers.skeleton) {
    return ObjectType::kSkeleton;
  }
  return ObjectType::kNone;
}

}  // namespace

void GenerateWorld(WorldState* state) {
  Board& board = state->board;
  RandomStream& random = state->random;
  const SimplexNoise noise(random.Below((uint32_t{1} << 31) - 1));
  absl::FixedArray<uint16_t, 64 * 64> traits(board.width() * board.height());
  ComputeTraits(noise, board.width(), board.height(), board.object(0).position, absl::MakeSpan(traits));
  const uint16_t* cell_traits = traits.data();
  for (int x = 0; x < board.width(); ++x) {
    for (int y = 0; y < board.height(); ++y) {
      const Material material = DrawMaterial(*cell_traits++, state->options.numbers, &random);
      board.SetMaterial({x, y}, material, DrawVariant(state->options, material, &random));
    }
  }
  cell_traits = traits.data();
  for (int x = 0; x < board.width(); ++x) {
    for (int y = 0; y < board.height(); ++y, ++cell_traits) {
      if (!kCreatureWalks.Contains(board.cell({x, y}).material)) continue;
      const ObjectType creature = DrawCreature(*state, {x, y}, *cell_traits, &random);
      if (creature != ObjectType::kNone) AddCreature(creature, {x, y}, state);
    }
  }
}

}  // namespace craftfleet
