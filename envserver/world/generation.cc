#include "envserver/world/generation.h"

#include <cstdint>
#include <utility>

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

ObjectType DrawCreature(Material material, uint16_t traits, int squared_distance, const NumberThresholds& numbers,
                        RandomStream* random) {
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
  const SimplexNoise noise(state->random.Below((uint32_t{1} << 31) - 1));
  absl::FixedArray<uint16_t, 64 * 64> traits(board.width() * board.height());
  ComputeTraits(noise, board.width(), board.height(), board.object(0).position, absl::MakeSpan(traits));
  const WorldOptions& options = state->options;
  const bool has_variants = !options.appearance.empty();  // calling DrawVariant for each cell takes a tenth of a reset
  const auto variant_of = [&](auto thing) {
    return has_variants ? DrawVariant(options, thing, &state->random) : kNoVariant;
  };
  const uint16_t* cell_traits = traits.data();
  board.SetMaterials([&] {
    const Material material = DrawMaterial(*cell_traits++, options.numbers, &state->random);
    return std::make_pair(material, variant_of(material));
  });
  cell_traits = traits.data();
  const BoardCell* cell = board.cells().data();
  const Position player = board.object(0).position;
  for (int x = 0; x < board.width(); ++x) {
    for (int y = 0; y < board.height(); ++y, ++cell, ++cell_traits) {
      if (!kCreatureWalks.Contains(cell->material)) continue;
      const int squared_distance = (x - player.x) * (x - player.x) + (y - player.y) * (y - player.y);
      const ObjectType creature =
          DrawCreature(cell->material, *cell_traits, squared_distance, options.numbers, &state->random);
      if (creature != ObjectType::kNone) AddCreature(creature, {x, y}, variant_of(creature), &board);
    }
  }
}

}  // namespace craftfleet
