#include "envserver/world/snapshot.h"

#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <limits>
#include <set>
#include <type_traits>
#include <utility>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_join.h>

#include "common/base/crc32c.h"
#include "common/base/little_endian.h"
#include "common/base/status_macros.h"
#include "envserver/world/appearance.h"
#include "envserver/world/daylight.h"

namespace craftfleet {
namespace {

constexpr absl::string_view kMagic = "CFWORLD";
constexpr uint8_t kVersion = 1;
// Keeps counters far from overflow, whatever a snapshot contains.
constexpr int64_t kMaxCount = 1'000'000'000;
constexpr int64_t kMaxLongCount = int64_t{1} << 52;
constexpr double kMaxNeed = 1000;
constexpr double kSlack = 1e-7;  // for sums of doubles

class Writer {
 public:
  template <typename T>
  void Put(T value) {
    AppendLittleEndian(value, &bytes_);
  }
  void Put(double value) {
    uint64_t bits;
    std::memcpy(&bits, &value, sizeof(bits));
    Put(bits);
  }
  void Put(absl::string_view bytes) { bytes_.append(bytes.data(), bytes.size()); }
  std::string Take() { return std::move(bytes_); }

 private:
  std::string bytes_;
};

// After the first value that is missing or out of range, all further values are 0, and status() names the first.
class Reader {
 public:
  explicit Reader(absl::string_view bytes) : rest_(bytes) {}

  template <typename T>
  T Get(absl::string_view name, int64_t low, int64_t high) {
    static_assert(std::is_integral_v<T>);
    const T value = GetRaw<T>();
    if (value < low || value > high) Fail(absl::StrCat(name, " ", value, ", want ", low, "..", high));
    return status_.ok() ? value : 0;
  }
  template <typename T>
  T GetAny() {
    return GetRaw<T>();
  }
  double GetDouble(absl::string_view name, double limit) {
    const auto bits = GetRaw<uint64_t>();
    double value;
    std::memcpy(&value, &bits, sizeof(value));
    if (!(std::abs(value) <= limit)) Fail(absl::StrCat(name, " ", value, ", want -", limit, "..", limit));
    return status_.ok() ? value : 0;
  }
  absl::string_view GetBytes(size_t size) {
    if (rest_.size() < size) Fail("cut short");
    if (!status_.ok()) return {};
    const absl::string_view bytes = rest_.substr(0, size);
    rest_.remove_prefix(size);
    return bytes;
  }
  // Keeps the first failure.
  void Fail(absl::string_view what) {
    if (status_.ok()) status_ = absl::DataLossError(absl::StrCat("snapshot: ", what));
  }
  const absl::Status& status() const { return status_; }
  absl::string_view rest() const { return rest_; }

 private:
  template <typename T>
  T GetRaw() {
    return FromLittleEndian<T>(GetBytes(sizeof(T)));
  }

  absl::string_view rest_;
  absl::Status status_;
};

std::string EncodeOptions(const WorldOptions& options) {
  const NumberThresholds& numbers = options.numbers;
  Writer writer;
  for (const int value : {options.width, options.height, options.view_width, options.view_height, options.length}) {
    writer.Put(static_cast<int32_t>(value));
  }
  for (const double value : {numbers.tree, numbers.coal, numbers.cow, numbers.zombie, numbers.skeleton}) {
    writer.Put(value);
  }
  for (const int value : options.percentages) writer.Put(static_cast<uint8_t>(value));
  writer.Put(static_cast<uint8_t>(options.appearance.size()));
  writer.Put(absl::string_view(options.appearance));
  return writer.Take();
}

std::string DescribeOptions(const WorldOptions& options) {
  return absl::StrCat(options.width, "x", options.height, " cells, view ", options.view_width, "x", options.view_height,
                      ", length ", options.length, ", appearance \"", options.appearance, "\" ",
                      absl::StrJoin(options.percentages, "/"), ", tree threshold ", options.numbers.tree);
}

void PutGame(const WorldState& state, Writer* writer) {
  writer->Put(state.seed);
  writer->Put(state.episode);
  writer->Put(state.step);
  writer->Put(state.episode_reward);
  writer->Put(static_cast<uint8_t>(state.last_health));
}

void GetGame(Reader* reader, WorldState* state) {
  state->seed = reader->GetAny<int64_t>();
  state->episode = reader->Get<int64_t>("episode", 1, kMaxLongCount);
  state->step = reader->Get<int64_t>("step", 0, kMaxLongCount);
  state->daylight = Daylight(state->step);
  state->episode_reward = reader->GetDouble("episode reward", static_cast<double>(kMaxLongCount));
  state->last_health = reader->Get<uint8_t>("last health", 0, kMaxItem);
}

void PutPlayer(const Player& player, Writer* writer) {
  writer->Put(static_cast<uint8_t>(player.sleeping));
  for (const int8_t amount : player.inventory) writer->Put(amount);
  for (const int32_t count : player.achievements) writer->Put(count);
  for (const double need : {player.hunger, player.thirst, player.fatigue, player.recover}) writer->Put(need);
  writer->Put(static_cast<uint8_t>(player.last_health));
}

void GetPlayer(Reader* reader, Player* player) {
  player->sleeping = reader->Get<uint8_t>("sleeping", 0, 1) != 0;
  for (int8_t& amount : player->inventory) amount = reader->Get<int8_t>("item", 0, kMaxItem);
  for (int32_t& count : player->achievements) count = reader->Get<int32_t>("achievement", 0, kMaxCount);
  for (double* need : {&player->hunger, &player->thirst, &player->fatigue, &player->recover}) {
    *need = reader->GetDouble("need", kMaxNeed);
  }
  player->last_health = reader->Get<uint8_t>("player's last health", 0, kMaxItem);
}

void PutStream(const RandomStream& stream, Writer* writer) {
  writer->Put(static_cast<uint16_t>(stream.position()));
  for (const uint32_t word : stream.state()) writer->Put(word);
}

void GetStream(Reader* reader, RandomStream* stream) {
  const int position = reader->Get<uint16_t>("stream position", 0, RandomStream::kStateWords);
  RandomStream::State words;
  for (uint32_t& word : words) word = reader->GetAny<uint32_t>();
  stream->Restore(words, position);
}

void PutCells(const Board& board, Writer* writer) {
  for (const BoardCell& cell : board.cells()) {
    writer->Put(static_cast<uint8_t>(static_cast<int>(cell.material) + 16 * (cell.variant - kNoVariant)));
  }
}

void GetCells(const WorldOptions& options, Reader* reader, Board* board) {
  for (int x = 0; x < board->width(); ++x) {
    for (int y = 0; y < board->height(); ++y) {
      const auto value = reader->GetAny<uint8_t>();
      const auto material = static_cast<Material>(value % 16);
      const auto variant = static_cast<Variant>(value / 16 + kNoVariant);
      if (material < Material::kWater || material > Material::kFurnace ||
          !IsPossibleVariant(options, material, variant)) {
        return reader->Fail(absl::StrCat("cell (", x, ", ", y, ") ", value, " has no such material or variant"));
      }
      board->SetMaterial({x, y}, material, variant);
    }
  }
}

void PutChunks(const Board& board, Writer* writer) {
  writer->Put(static_cast<uint16_t>(board.known_chunks().size()));
  for (const int16_t chunk : board.known_chunks()) writer->Put(chunk);
}

void GetChunks(Reader* reader, Board* board) {
  const int count = reader->Get<uint16_t>("number of chunks", 0, board->num_chunks());
  for (int i = 0; i < count; ++i) {
    const int chunk = reader->Get<int16_t>("chunk", 0, board->num_chunks() - 1);
    if (board->chunk(chunk).known) reader->Fail(absl::StrCat("chunk ", chunk, " is named twice"));
    board->LearnChunk(chunk);
  }
}

void PutObjects(const Board& board, Writer* writer) {
  writer->Put(board.entries());
  writer->Put(static_cast<uint16_t>(board.objects().size()));
  for (const Object& object : board.objects()) {
    writer->Put(static_cast<uint8_t>(object.type));
    writer->Put(object.variant);
    writer->Put(object.health);
    writer->Put(static_cast<int16_t>(object.position.x));
    writer->Put(static_cast<int16_t>(object.position.y));
    writer->Put(static_cast<int16_t>(object.facing.x));
    writer->Put(static_cast<int16_t>(object.facing.y));
    writer->Put(object.counter);
    writer->Put(object.entered);
  }
}

Object GetObject(bool player, int64_t entries, Reader* reader) {
  Object object;
  const auto first = static_cast<int64_t>(player ? ObjectType::kPlayer : ObjectType::kCow);
  const auto last = static_cast<int64_t>(player ? ObjectType::kPlayer : ObjectType::kPlant);
  object.type = static_cast<ObjectType>(reader->Get<uint8_t>("object type", first, last));
  object.variant = reader->Get<int8_t>("variant", kNoVariant, kNumVariants - 1);
  object.health = reader->Get<int16_t>("health", 0, std::numeric_limits<int16_t>::max());
  object.position.x = reader->GetAny<int16_t>();
  object.position.y = reader->GetAny<int16_t>();
  object.facing.x = reader->Get<int16_t>("facing", -1, 1);
  object.facing.y = reader->Get<int16_t>("facing", -1, 1);
  object.counter = reader->Get<int32_t>("counter", 0, kMaxCount);
  object.entered = reader->Get<int64_t>("entry", 0, entries - 1);
  return object;
}

// The invariants of Board and of the renderer; empty: they hold.
absl::string_view ObjectProblem(const WorldOptions& options, const Board& board, const Object& object) {
  if (!board.Inside(object.position)) return "is outside the world";
  if (board.ObjectAt(object.position) >= 0) return "is on the cell of another object";
  if (!board.chunk(board.ChunkIndex(object.position)).known) return "is in an unknown chunk";
  if (!IsPossibleVariant(options, object.type, object.variant)) return "has no such variant";
  const bool faces = object.type == ObjectType::kPlayer || object.type == ObjectType::kArrow;
  if (std::abs(object.facing.x) + std::abs(object.facing.y) != (faces ? 1 : 0)) return "faces nowhere";
  return "";
}

void GetObjects(const WorldOptions& options, Reader* reader, Board* board) {
  const int64_t entries = reader->Get<int64_t>("entries", 1, kMaxLongCount);
  const int count = reader->Get<uint16_t>("number of objects", 1, options.width * options.height);
  std::set<int64_t> entered;
  for (int i = 0; i < count; ++i) {
    const Object object = GetObject(i == 0, entries, reader);
    if (!reader->status().ok()) return;
    const absl::string_view wrong = ObjectProblem(options, *board, object);
    if (!wrong.empty()) return reader->Fail(absl::StrCat("object ", i, " ", wrong));
    // Balancing counts the creatures of a chunk by their entries.
    if (!entered.insert(object.entered).second) {
      return reader->Fail(absl::StrCat("object ", i, " has another object's entry, ", object.entered));
    }
    const int index = board->Add(object);
    board->object(index).entered = object.entered;
  }
  board->set_entries(entries);
}

// What the episode's own steps leave (RULES.md, section 5). Others would end with numbers that no game has, and that a
// learner refuses whoever plays them.
void CheckProgress(const WorldState& state, Reader* reader) {
  const int health = state.player.health();
  if (state.last_health != health) {
    reader->Fail(absl::StrCat("last health ", state.last_health, ", want the player's, ", health));
  }
  int unlocked = 0;
  for (const int32_t count : state.player.achievements) {
    if (count > state.step) reader->Fail(absl::StrCat("achievement ", count, " after ", state.step, " steps"));
    unlocked += count > 0 ? 1 : 0;
  }
  const double lost = (health - kMaxItem) / 10.0;
  const double low = lost + (unlocked > 0 ? 1 : 0);  // all unlocked by one step
  const double high = lost + unlocked;
  if (!(state.episode_reward >= low - kSlack && state.episode_reward <= high + kSlack)) {
    reader->Fail(absl::StrCat("episode reward ", state.episode_reward, ", want ", low, "..", high));
  }
}

}  // namespace

std::string SaveState(const WorldState& state, const RandomStream& stream) {
  Writer body;
  body.Put(absl::string_view(EncodeOptions(state.options)));
  PutGame(state, &body);
  PutPlayer(state.player, &body);
  PutStream(stream, &body);
  PutCells(state.board, &body);
  PutChunks(state.board, &body);
  PutObjects(state.board, &body);
  const std::string bytes = body.Take();
  Writer snapshot;
  snapshot.Put(kMagic);
  snapshot.Put(kVersion);
  snapshot.Put(Crc32c(bytes));
  snapshot.Put(absl::string_view(bytes));
  return snapshot.Take();
}

absl::Status RestoreState(absl::string_view snapshot, WorldState* state) {
  Reader reader(snapshot);
  if (reader.GetBytes(kMagic.size()) != kMagic) reader.Fail("not a world's");
  const auto version = reader.GetAny<uint8_t>();
  const auto checksum = reader.GetAny<uint32_t>();
  CRAFTFLEET_RETURN_IF_ERROR(reader.status());
  if (version != kVersion) {
    return absl::InvalidArgumentError(absl::StrCat("snapshot: version ", version, ", want ", kVersion));
  }
  if (checksum != Crc32c(reader.rest())) return absl::DataLossError("snapshot: cut or damaged (its checksum differs)");
  const std::string options = EncodeOptions(state->options);
  const absl::string_view found = reader.GetBytes(options.size());
  CRAFTFLEET_RETURN_IF_ERROR(reader.status());
  if (found != options) {
    return absl::InvalidArgumentError(
        absl::StrCat("snapshot: of a world with other options than this one's ", DescribeOptions(state->options)));
  }
  WorldState restored(state->options);
  GetGame(&reader, &restored);
  GetPlayer(&reader, &restored.player);
  GetStream(&reader, &restored.random);
  CRAFTFLEET_RETURN_IF_ERROR(reader.status());
  GetCells(restored.options, &reader, &restored.board);
  GetChunks(&reader, &restored.board);
  GetObjects(restored.options, &reader, &restored.board);
  CheckProgress(restored, &reader);
  if (!reader.rest().empty()) reader.Fail("bytes are left over");
  CRAFTFLEET_RETURN_IF_ERROR(reader.status());
  *state = std::move(restored);
  return absl::OkStatus();
}

}  // namespace craftfleet
