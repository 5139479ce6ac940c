// Turns the frames of an environment server's replies into pixels, whatever their format.

#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include <absl/status/status.h>
#include <absl/strings/string_view.h>
#include <absl/types/span.h>

#include "craftfleet/v1/environment.pb.h"
#include "envserver/render/scene_record.h"

namespace craftfleet {

// Owned by one thread. Errors are InvalidArgument with field, value and what was expected.
class FrameReader {
 public:
  // For sessions that begin with `hello`. Scene records are read only if this program can draw them
  // (built_in_renderer.h).
  FrameReader(const v1::SessionHello& hello, int frame_bytes);

  // Begins a session, whose format the reply to hello says.
  absl::Status Begin(const v1::PlayReply& reply);

  // These replace the frames of a reply by pixels, and append the record of each of `frames` to `records`; only
  // scenes have one. Sizes are checked afterwards.
  absl::Status ReadOpened(const v1::OpenLanes& request, v1::PlayReply* reply, std::vector<std::string>* records);
  absl::Status ReadStep(const v1::StepLanes& request, v1::PlayReply* reply, std::vector<std::string>* records);

  // Forgets games.
  void Close(absl::Span<const int> lanes);

 private:
  // Draws the frame of the record at the beginning of `bytes`, removes the record, and appends the frame to `pixels`.
  absl::Status Draw(int lane, absl::string_view* bytes, std::string* pixels);

  const int frame_bytes_;
  std::shared_ptr<const Renderer> renderer_;  // null: no scene records
  v1::FrameFormat format_ = v1::FRAMES_RAW;   // of the session
  std::map<int, SceneReader> readers_;        // by lane
  std::string pixels_;                        // reused
};

}  // namespace craftfleet
