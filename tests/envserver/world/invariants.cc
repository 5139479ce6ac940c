#include "tests/envserver/world/invariants.h"

#include <algorithm>
#include <array>
#include <set>
#include <vector>

#include <absl/strings/str_cat.h>

#include "envserver/world/rules.h"
#include "tests/golden/world_editor.h"

namespace craftfleet {
namespace {

std::string BrokenPlayer(const World& world) {
  const Player& player = world.player();
  for (int i = 0; i < kNumItems; ++i) {
    const int amount = player.item(static_cast<Item>(i));
    if (amount < 0 || amount > kMaxItem) return absl::StrCat(kItemNames[i], " is ", amount);
  }
  const Position facing = world.objects()[0].facing;
  if (std::abs(facing.x) + std::abs(facing.y) != 1) return "the player faces nowhere";
  if (world.objects()[0].type != ObjectType::kPlayer) return "the first object is not the player";
  const auto in = [](double value, double low, double high) { return value >= low && value <= high; };
  if (!in(player.hunger, 0, 25) || !in(player.thirst, 0, 20)) return "hunger or thirst is out of range";
  if (!in(player.fatigue, -10, 30) || !in(player.recover, -15, 25)) return "fatigue or recover is out of range";
  if (!in(world.daylight(), 0, 1)) return absl::StrCat("daylight is ", world.daylight());
  return "";
}

// The materials on which each type may be. An arrow that breaks a table was never on the table's cell.
bool MayStandOn(ObjectType type, Material material) {
  switch (type) {
    case ObjectType::kPlayer:
      return kPlayerWalks.Contains(material);
    case ObjectType::kArrow:
      return kArrowFlies.Contains(material);
    case ObjectType::kPlant:
      return material == Material::kGrass;
    default:
      return kCreatureWalks.Contains(material);
  }
}

std::string BrokenObject(const WorldState& state, int index) {
  const Board& board = state.board;
  const Object& object = board.object(index);
  const auto at = absl::StrCat("object ", index, " at (", object.position.x, ", ", object.position.y, ") ");
  if (object.removed) return at + "is removed";
  if (!board.Inside(object.position)) return at + "is outside";
  if (board.ObjectAt(object.position) != index) return at + "is not in its cell";
  if (!MayStandOn(object.type, board.material(object.position))) return at + "is on a material where it may not be";
  if (object.health < 0) return at + "has a negative health";
  if ((object.type == ObjectType::kPlayer) != (index == 0))
    return at + "must be the player if and only if it is the first object";
  if (!board.chunk(board.ChunkIndex(object.position)).known) return at + "is in an unknown chunk";
  if (object.entered < 0 || object.entered >= board.entries()) return at + "has an impossible entry";
  return "";
}

std::string BrokenChunks(const Board& board) {
  std::vector<std::array<int32_t, kNumMaterials>> materials(board.num_chunks());
  std::vector<std::array<int32_t, kNumObjectTypes>> objects(board.num_chunks());
  for (int x = 0; x < board.width(); ++x) {
    for (int y = 0; y < board.height(); ++y) {
      const Position p = {x, y};
      ++materials[board.ChunkIndex(p)][static_cast<int>(board.material(p))];
      const int object = board.ObjectAt(p);
      if (object < 0) continue;
      if (object >= static_cast<int>(board.objects().size())) return "a cell holds an object that does not exist";
      if (board.object(object).position != p) return "a cell holds an object that is elsewhere";
      ++objects[board.ChunkIndex(p)][static_cast<int>(board.object(object).type)];
    }
  }
  for (int i = 0; i < board.num_chunks(); ++i) {
    if (materials[i] != board.chunk(i).materials) return absl::StrCat("chunk ", i, " counts its materials wrongly");
    if (objects[i] != board.chunk(i).objects) return absl::StrCat("chunk ", i, " counts its objects wrongly");
  }
  const std::set<int> known(board.known_chunks().begin(), board.known_chunks().end());
  if (known.size() != board.known_chunks().size()) return "a chunk is known twice";
  for (int i = 0; i < board.num_chunks(); ++i) {
    if (board.chunk(i).known != (known.count(i) > 0)) return absl::StrCat("chunk ", i, " is known and not listed");
  }
  return "";
}

}  // namespace

std::string BrokenInvariant(const World& world) {
  const WorldState& state = WorldEditor::State(world);
  std::set<int64_t> entries;
  for (int i = 0; i < static_cast<int>(state.board.objects().size()); ++i) {
    std::string broken = BrokenObject(state, i);
    if (!broken.empty()) return broken;
    if (!entries.insert(state.board.object(i).entered).second) return "two objects share an entry";
  }
  std::string broken = BrokenPlayer(world);
  return broken.empty() ? BrokenChunks(state.board) : broken;
}

}  // namespace craftfleet
