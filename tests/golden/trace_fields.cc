#include "tests/golden/trace_fields.h"

#include <zlib.h>

#include <algorithm>
#include <array>
#include <cstring>
#include <vector>

#include <absl/strings/str_format.h>

#include "envserver/world/episode_seed.h"
#include "tests/golden/world_editor.h"

namespace craftfleet {
namespace {

using nlohmann::ordered_json;

// Appends the low `bytes` bytes of `value`, little-endian.
void Append(int64_t value, int bytes, std::string* out) {
  for (int i = 0; i < bytes; ++i) out->push_back(static_cast<char>(value >> (8 * i)));
}

std::string Materials(const Board& board) {
  std::string out;
  for (const BoardCell& cell : board.cells()) Append(static_cast<int>(cell.material), 1, &out);
  return out;
}

std::string MaterialVariants(const Board& board) {
  std::string out;
  for (const BoardCell& cell : board.cells()) Append(cell.variant + 1, 1, &out);
  return out;
}

std::string ObjectVariants(const Board& board) {
  std::string out;
  for (const Object& object : board.objects()) Append(object.variant + 1, 1, &out);
  return out;
}

int Auxiliary(const Object& object) {
  const bool faces = object.type == ObjectType::kPlayer || object.type == ObjectType::kArrow;
  return faces ? (object.facing.x + 1) * 3 + object.facing.y + 1 : object.counter;
}

std::string Objects(const WorldState& state, bool with_auxiliary) {
  std::string out;
  for (const Object& object : state.board.objects()) {
    Append(static_cast<int>(object.type), 1, &out);
    Append(object.position.x, 2, &out);
    Append(object.position.y, 2, &out);
    Append(object.type == ObjectType::kPlayer ? state.player.health() : object.health, 2, &out);
    if (with_auxiliary) Append(Auxiliary(object), 4, &out);
  }
  return out;
}

std::string Chunks(const Board& board) {
  std::string out;
  for (const int index : board.known_chunks()) {
    std::vector<const Object*> members;
    for (const Object& object : board.objects()) {
      if (board.ChunkIndex(object.position) == index) members.push_back(&object);
    }
    std::sort(members.begin(), members.end(), [](const Object* a, const Object* b) { return a->entered < b->entered; });
    Append(board.chunk(index).min.x, 2, &out);
    Append(board.chunk(index).min.y, 2, &out);
    Append(static_cast<int64_t>(members.size()), 2, &out);
    for (const Object* member : members) {
      Append(member->position.x, 2, &out);
      Append(member->position.y, 2, &out);
    }
  }
  return out;
}

std::string NextDraws(RandomStream stream) {
  std::string out;
  for (int i = 0; i < 8; ++i) {
    const double draw = stream.Uniform();
    int64_t bits;
    std::memcpy(&bits, &draw, sizeof(bits));
    Append(bits, 8, &out);
  }
  return out;
}

std::string SemanticView(const World& world) {
  std::string out(static_cast<size_t>(world.options().width) * world.options().height, '\0');
  world.SemanticView(absl::MakeSpan(reinterpret_cast<uint8_t*>(out.data()), out.size()));
  return out;
}

ordered_json Pair(Position p) { return ordered_json::array({p.x, p.y}); }

}  // namespace

std::string CrcText(absl::string_view bytes) {
  return absl::StrFormat("%08x", crc32(0, reinterpret_cast<const Bytef*>(bytes.data()), bytes.size()));
}

std::string CrcText(absl::Span<const uint8_t> bytes) {
  return CrcText(absl::string_view(reinterpret_cast<const char*>(bytes.data()), bytes.size()));
}

ordered_json TraceFields(const World& world) {
  const WorldState& state = WorldEditor::State(world);
  const Player& player = world.player();
  ordered_json fields;
  fields["ep"] = world.episode();
  fields["eseed"] = EpisodeSeed(world.seed(), world.episode());
  fields["n"] = world.step();
  fields["p"] = Pair(world.player_position());
  fields["f"] = Pair(world.objects()[0].facing);
  fields["z"] = player.sleeping ? 1 : 0;
  fields["inv"] = player.inventory;
  fields["ach"] = player.achievements;
  fields["ctr"] = {player.hunger, player.thirst, player.fatigue, player.recover};
  fields["day"] = world.daylight();
  fields["nobj"] = world.objects().size();
  fields["mat"] = CrcText(Materials(state.board));
  fields["obj"] = CrcText(Objects(state, /*with_auxiliary=*/false));
  fields["obx"] = CrcText(Objects(state, /*with_auxiliary=*/true));
  fields["chk"] = CrcText(Chunks(state.board));
  fields["sem"] = CrcText(SemanticView(world));
  fields["rng"] = CrcText(NextDraws(world.random()));
  fields["mtp"] = world.random().position();
  fields["mvar"] = CrcText(MaterialVariants(state.board));
  fields["ovar"] = CrcText(ObjectVariants(state.board));
  return fields;
}

}  // namespace craftfleet
