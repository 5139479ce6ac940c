#include "envserver/render/scene_record.h"

#include <cstring>

#include <absl/strings/str_format.h>

#include "common/base/check.h"
#include "common/base/little_endian.h"
#include "common/base/status_macros.h"

namespace craftfleet {
namespace {

constexpr int kAsleep = 1;
constexpr int kStateFollows = 2;
static_assert(kMaxWordsBetween <= 65535);

// A vector's size or index as the type of the record.
template <typename T>
void Put(size_t value, std::string* out) {
  AppendLittleEndian(static_cast<T>(value), out);
}

absl::Status Cut() { return absl::InvalidArgumentError("scene record: it is cut short"); }

absl::Status OutOfRange(absl::string_view field, int value, absl::string_view wanted) {
  return absl::InvalidArgumentError(absl::StrFormat("scene record: %s %d, want %s", field, value, wanted));
}

// Takes `size` bytes from the beginning of `bytes` if it has them.
bool Take(size_t size, absl::string_view* bytes, absl::string_view* taken) {
  if (bytes->size() < size) return false;
  *taken = bytes->substr(0, size);
  bytes->remove_prefix(size);
  return true;
}

template <typename T>
bool TakeNumber(absl::string_view* bytes, T* value) {
  absl::string_view taken;
  if (!Take(sizeof(T), bytes, &taken)) return false;
  *value = FromLittleEndian<T>(taken);
  return true;
}

void PutFlagsAndLight(const Scene& scene, bool has_state, std::string* out) {
  out->push_back(static_cast<char>((scene.sleeping ? kAsleep : 0) | (has_state ? kStateFollows : 0)));
  uint64_t light;
  std::memcpy(&light, &scene.daylight, sizeof(light));
  AppendLittleEndian(light, out);
  for (int item = 0; item < kNumItems; item += 2) {
    out->push_back(static_cast<char>(scene.inventory[item] | scene.inventory[item + 1] << 4));
  }
}

absl::Status ReadFlagsAndLight(absl::string_view* bytes, Scene* scene, bool* has_state) {
  uint8_t flags = 0;
  uint64_t light = 0;
  absl::string_view items;
  if (!TakeNumber(bytes, &flags) || !TakeNumber(bytes, &light) || !Take(kNumItems / 2, bytes, &items)) return Cut();
  if (flags > (kAsleep | kStateFollows)) return OutOfRange("flags", flags, "0..3");
  scene->sleeping = (flags & kAsleep) != 0;
  *has_state = (flags & kStateFollows) != 0;
  std::memcpy(&scene->daylight, &light, sizeof(light));
  if (!(scene->daylight >= 0 && scene->daylight <= 1)) {
    return absl::InvalidArgumentError(absl::StrFormat("scene record: daylight %g, want 0..1", scene->daylight));
  }
  if (*has_state && !scene->is_dark()) return OutOfRange("flags", flags, "no stream by day");
  for (int item = 0; item < kNumItems; ++item) {
    const int amount = static_cast<uint8_t>(items[item / 2]) >> item % 2 * 4 & 15;
    if (amount > kMaxItem) return OutOfRange("item", amount, "0..9");
    scene->inventory[item] = static_cast<int8_t>(amount);
  }
  return absl::OkStatus();
}

void PutCells(const Scene& scene, std::string* out) {
  out->append(reinterpret_cast<const char*>(scene.ground.data()), scene.ground.size());
  Put<uint16_t>(scene.things.size(), out);
  for (const Scene::Thing& thing : scene.things) {
    Put<uint16_t>(thing.cell, out);
    Put<uint8_t>(thing.sprite, out);
  }
}

absl::Status ReadCells(const Renderer& renderer, absl::string_view* bytes, Scene* scene) {
  const int cells = renderer.num_cells();
  absl::string_view ground;
  uint16_t count = 0;
  if (!Take(cells, bytes, &ground) || !TakeNumber(bytes, &count)) return Cut();
  scene->ground.assign(ground.begin(), ground.end());
  for (const uint8_t sprite : scene->ground) {
    if (!renderer.ShowsAsGround(sprite)) return OutOfRange("ground", sprite, "a material of this game");
  }
  if (count > cells) return OutOfRange("things", count, absl::StrFormat("0..%d", cells));
  scene->things.resize(count);
  int last_cell = -1;
  for (Scene::Thing& thing : scene->things) {
    if (!TakeNumber(bytes, &thing.cell) || !TakeNumber(bytes, &thing.sprite)) return Cut();
    if (thing.cell <= last_cell || thing.cell >= cells) {
      return OutOfRange("cell", thing.cell, absl::StrFormat("%d..%d", last_cell + 1, cells - 1));
    }
    if (!renderer.ShowsAsThing(thing.sprite)) return OutOfRange("thing", thing.sprite, "one of this game");
    last_cell = thing.cell;
  }
  return absl::OkStatus();
}

void PutState(const RandomStream& stream, std::string* out) {
  Put<uint16_t>(stream.position(), out);
  for (const uint32_t word : stream.state()) AppendLittleEndian(word, out);
}

absl::Status ReadState(absl::string_view* bytes, RandomStream* stream) {
  uint16_t position = 0;
  absl::string_view words;
  if (!TakeNumber(bytes, &position) || !Take(sizeof(uint32_t) * RandomStream::kStateWords, bytes, &words)) {
    return Cut();
  }
  if (position > RandomStream::kStateWords) return OutOfRange("position", position, "0..624");
  RandomStream::State state;
  for (uint32_t& word : state) {
    word = FromLittleEndian<uint32_t>(words.substr(0, sizeof(word)));
    words.remove_prefix(sizeof(word));
  }
  stream->Restore(state, position);
  return absl::OkStatus();
}

}  // namespace

void SceneWriter::Append(const Renderer& renderer, const Scene& scene, const RandomStream& stream, std::string* out) {
  const int64_t between = drawn_ == kUnknown ? 0 : stream.drawn() - drawn_;
  CRAFTFLEET_CHECK(between >= 0);
  const bool has_state = scene.is_dark() && (drawn_ == kUnknown || between > kMaxWordsBetween);
  PutFlagsAndLight(scene, has_state, out);
  PutCells(scene, out);
  if (!scene.is_dark()) return;
  if (has_state) {
    PutState(stream, out);
  } else {
    Put<uint16_t>(between, out);
  }
  drawn_ = stream.drawn() + renderer.noise_words();
}

absl::Status SceneReader::Draw(const Renderer& renderer, absl::string_view* bytes, absl::Span<uint8_t> frame) {
  bool has_state = false;
  CRAFTFLEET_RETURN_IF_ERROR(ReadFlagsAndLight(bytes, &scene_, &has_state));
  CRAFTFLEET_RETURN_IF_ERROR(ReadCells(renderer, bytes, &scene_));
  if (scene_.is_dark()) CRAFTFLEET_RETURN_IF_ERROR(ReadNoise(has_state, bytes));
  renderer.Render(scene_, &stream_, frame);
  return absl::OkStatus();
}

absl::Status SceneReader::ReadNoise(bool has_state, absl::string_view* bytes) {
  if (has_state) {
    CRAFTFLEET_RETURN_IF_ERROR(ReadState(bytes, &stream_));
    has_stream_ = true;
    return absl::OkStatus();
  }
  uint16_t between = 0;
  if (!TakeNumber(bytes, &between)) return Cut();
  if (between > kMaxWordsBetween) return OutOfRange("words", between, absl::StrFormat("0..%d", kMaxWordsBetween));
  if (!has_stream_) return absl::InvalidArgumentError("scene record: noise without a stream, want its state before");
  stream_.Skip(between);
  return absl::OkStatus();
}

}  // namespace craftfleet
