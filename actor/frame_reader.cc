#include "actor/frame_reader.h"

#include <algorithm>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>

#include "common/base/status_macros.h"
#include "common/base/types.h"
#include "envserver/render/built_in_renderer.h"

namespace craftfleet {
namespace {

absl::Status About(absl::string_view field, const absl::Status& status) {
  return status.ok() ? status : absl::InvalidArgumentError(absl::StrCat(field, ": ", status.message()));
}

absl::Status CheckUsedUp(absl::string_view field, absl::string_view rest) {
  if (rest.empty()) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrFormat("%s: %d bytes after the last record, want 0", field, rest.size()));
}

bool AsksFor(const v1::SessionHello& hello, v1::FrameFormat format) {
  return std::find(hello.frame_formats().begin(), hello.frame_formats().end(), format) != hello.frame_formats().end();
}

}  // namespace

FrameReader::FrameReader(const v1::SessionHello& hello, int frame_bytes) : frame_bytes_(frame_bytes) {
  if (!AsksFor(hello, v1::FRAMES_SCENE)) return;
  const auto renderer = BuiltInRenderer(hello.env().name(), hello.env().frame_size());
  if (renderer.ok() && (*renderer)->frame_bytes() == frame_bytes) renderer_ = *renderer;
}

absl::Status FrameReader::Begin(const v1::PlayReply& reply) {
  readers_.clear();
  format_ = reply.frame_format();
  if (format_ == v1::FRAMES_RAW) return absl::OkStatus();
  if (format_ == v1::FRAMES_SCENE && renderer_ != nullptr) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrFormat("frame_format %d, want raw, 0, or one that hello asked for", static_cast<int>(format_)));
}

absl::Status FrameReader::ReadOpened(const v1::OpenLanes& request, v1::PlayReply* reply,
                                     std::vector<std::string>* records) {
  if (format_ == v1::FRAMES_RAW) return absl::OkStatus();
  pixels_.clear();
  absl::string_view bytes = reply->frames();
  int refused = 0;
  for (const v1::OpenLanes::Lane& lane : request.lanes()) {
    if (refused < reply->refused_size() && reply->refused(refused).lane() == lane.lane()) {
      ++refused;
      continue;
    }
    readers_[lane.lane()].Restart();
    const absl::string_view before = bytes;
    CRAFTFLEET_RETURN_IF_ERROR(About("frames", Draw(lane.lane(), &bytes, &pixels_)));
    records->emplace_back(before.substr(0, before.size() - bytes.size()));
  }
  CRAFTFLEET_RETURN_IF_ERROR(CheckUsedUp("frames", bytes));
  reply->mutable_frames()->swap(pixels_);
  return absl::OkStatus();
}

absl::Status FrameReader::ReadStep(const v1::StepLanes& request, v1::PlayReply* reply,
                                   std::vector<std::string>* records) {
  if (format_ == v1::FRAMES_RAW) return absl::OkStatus();
  if (reply->ends().size() != static_cast<size_t>(request.lanes_size())) {
    return absl::InvalidArgumentError(
        absl::StrFormat("ends: %d bytes, want %d", reply->ends().size(), request.lanes_size()));
  }
  pixels_.clear();
  std::string last_pixels;
  absl::string_view bytes = reply->frames();
  absl::string_view last_bytes = reply->last_frames();
  for (int row = 0; row < request.lanes_size(); ++row) {
    const int lane = request.lanes(row);
    if (reply->ends()[row] == static_cast<char>(StepEnd::kTruncated)) {
      CRAFTFLEET_RETURN_IF_ERROR(About("last_frames", Draw(lane, &last_bytes, &last_pixels)));
    }
    const absl::string_view before = bytes;
    CRAFTFLEET_RETURN_IF_ERROR(About("frames", Draw(lane, &bytes, &pixels_)));
    records->emplace_back(before.substr(0, before.size() - bytes.size()));
  }
  CRAFTFLEET_RETURN_IF_ERROR(CheckUsedUp("frames", bytes));
  CRAFTFLEET_RETURN_IF_ERROR(CheckUsedUp("last_frames", last_bytes));
  reply->mutable_frames()->swap(pixels_);
  reply->mutable_last_frames()->swap(last_pixels);
  return absl::OkStatus();
}

absl::Status FrameReader::Draw(int lane, absl::string_view* bytes, std::string* pixels) {
  const size_t size = pixels->size();
  pixels->resize(size + frame_bytes_);
  uint8_t* frame = reinterpret_cast<uint8_t*>(pixels->data()) + size;
  return readers_[lane].Draw(*renderer_, bytes, absl::MakeSpan(frame, frame_bytes_));
}

void FrameReader::Close(absl::Span<const int> lanes) {
  for (const int lane : lanes) readers_.erase(lane);
}

}  // namespace craftfleet
