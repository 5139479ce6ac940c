#include "learner/training/fragments/fragment_frames.h"

#include <absl/strings/str_format.h>
#include <absl/strings/string_view.h>

#include "common/base/status_macros.h"
#include "common/config/known_canary.h"
#include "envserver/render/built_in_renderer.h"
#include "envserver/render/scene_record.h"

namespace craftfleet {

FragmentFrames::FragmentFrames(const v1::RunConfig& config, const std::string& texture_digest)
    : frame_bytes_(3 * static_cast<size_t>(config.env().frame_size()) * config.env().frame_size()) {
  if (texture_digest != kBuiltInTextures) return;
  const auto renderer = BuiltInRenderer(config.env().name(), config.env().frame_size());
  if (renderer.ok()) renderer_ = *renderer;
}

void FragmentFrames::AddFormats(v1::JoinReply* reply) const {
  if (renderer_ != nullptr) reply->add_frame_formats(v1::FRAMES_SCENE);
}

absl::Status FragmentFrames::Draw(int steps, v1::FragmentMessage* message) const {
  if (message->frame_format() == v1::FRAMES_RAW) return absl::OkStatus();
  if (message->frame_format() != v1::FRAMES_SCENE || renderer_ == nullptr) {
    return absl::InvalidArgumentError(
        absl::StrFormat("frame_format: %d, want raw, 0, or one of the reply to Join", message->frame_format()));
  }
  CRAFTFLEET_RETURN_IF_ERROR(DrawScenes(steps, message->mutable_frames()));
  message->set_frame_format(v1::FRAMES_RAW);
  return absl::OkStatus();
}

absl::Status FragmentFrames::DrawScenes(int steps, std::string* frames) const {
  absl::string_view records = *frames;
  std::string pixels(steps * frame_bytes_, '\0');
  auto* frame = reinterpret_cast<uint8_t*>(pixels.data());
  SceneReader reader;
  for (int step = 0; step < steps; ++step, frame += frame_bytes_) {
    const absl::Status status = reader.Draw(*renderer_, &records, absl::MakeSpan(frame, frame_bytes_));
    if (!status.ok()) return absl::InvalidArgumentError(absl::StrFormat("frames: step %d: %s", step, status.message()));
  }
  if (!records.empty()) {
    return absl::InvalidArgumentError(
        absl::StrFormat("frames: %d bytes after the last step's record, want 0", records.size()));
  }
  frames->swap(pixels);
  return absl::OkStatus();
}

}  // namespace craftfleet
