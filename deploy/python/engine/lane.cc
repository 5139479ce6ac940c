#include "engine/lane.h"

#include <utility>

#include "common/base/check.h"
#include "common/base/crc32c.h"
#include "common/base/little_endian.h"
#include "common/base/status_macros.h"

namespace craftfleet {
namespace {

constexpr size_t kWordBytes = sizeof(uint32_t);
constexpr size_t kStreamBytes = RandomStream::kStateWords * kWordBytes + sizeof(uint16_t);

std::string SaveStream(const RandomStream& stream) {
  std::string bytes;
  for (const uint32_t word : stream.state()) AppendLittleEndian(word, &bytes);
  AppendLittleEndian(static_cast<uint16_t>(stream.position()), &bytes);
  return bytes;
}

// `bytes`: kStreamBytes of them.
absl::StatusOr<RandomStream> RestoreStream(absl::string_view bytes) {
  RandomStream::State words;
  for (uint32_t& word : words) {
    word = FromLittleEndian<uint32_t>(bytes.substr(0, kWordBytes));
    bytes.remove_prefix(kWordBytes);
  }
  const int position = FromLittleEndian<uint16_t>(bytes);
  if (position > RandomStream::kStateWords) return absl::DataLossError("snapshot: impossible random stream");
  RandomStream stream;
  stream.Restore(words, position);
  return stream;
}

}  // namespace

void Lane::Reset(absl::Span<uint8_t> frame) {
  if (started()) {
    world_->Reset();
  } else {
    absl::StatusOr<World> world = World::Create(setup_->world(), seed_);
    CRAFTFLEET_CHECK(world.ok());  // the setup has checked the options
    world_ = *std::move(world);
  }
  Draw(frame);
}

StepOutcome Lane::Step(Action action, absl::Span<uint8_t> frame) {
  const StepOutcome outcome = world_->Step(action);
  Draw(frame);
  return outcome;
}

void Lane::Redraw(const Renderer& renderer, absl::Span<uint8_t> frame) const {
  RandomStream stream = before_picture_;
  renderer.Render(*world_, &stream, frame);
}

void Lane::DrawFromStream(const Renderer& renderer, absl::Span<uint8_t> frame) {
  renderer.Render(*world_, &world_->random(), frame);
}

std::string Lane::Save() const {
  std::string bytes = SaveStream(before_picture_);
  AppendLittleEndian(Crc32c(bytes), &bytes);
  return bytes + world_->Save(world_->random());
}

absl::Status Lane::Restore(absl::string_view snapshot) {
  const absl::string_view stream = snapshot.substr(0, kStreamBytes);
  snapshot.remove_prefix(stream.size());
  const absl::string_view checksum = snapshot.substr(0, kWordBytes);
  snapshot.remove_prefix(checksum.size());
  if (checksum.size() < kWordBytes || FromLittleEndian<uint32_t>(checksum) != Crc32c(stream)) {
    return absl::DataLossError("snapshot: cut, damaged, or not of a game");
  }
  CRAFTFLEET_ASSIGN_OR_RETURN(const RandomStream before_picture, RestoreStream(stream));
  if (started()) {  // planners restore often: into the world that is there, because generating one takes longest
    CRAFTFLEET_RETURN_IF_ERROR(world_->Restore(snapshot));
  } else {
    CRAFTFLEET_ASSIGN_OR_RETURN(World world, World::Create(setup_->world(), seed_));
    CRAFTFLEET_RETURN_IF_ERROR(world.Restore(snapshot));
    world_ = std::move(world);
  }
  seed_ = world_->seed();
  before_picture_ = before_picture;
  return absl::OkStatus();
}

void Lane::Draw(absl::Span<uint8_t> frame) {
  before_picture_ = world_->random();
  setup_->renderer().Render(*world_, &world_->random(), frame);
}

}  // namespace craftfleet
