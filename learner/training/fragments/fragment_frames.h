// Turns the frames of a received fragment into pixels, so that everything behind the service sees the same bytes
// whichever format an actor sends.

#pragma once

#include <cstddef>
#include <memory>
#include <string>

#include <absl/status/status.h>

#include "craftfleet/v1/config.pb.h"
#include "craftfleet/v1/learner.pb.h"
#include "envserver/render/renderer.h"

namespace craftfleet {

// Immutable: any number of threads draw at once.
class FragmentFrames {
 public:
  // For a run with `config` whose textures have this digest. It can draw scenes if these are compiled into this
  // program.
  FragmentFrames(const v1::RunConfig& config, const std::string& texture_digest);

  // Adds the formats that fragments may have besides raw.
  void AddFormats(v1::JoinReply* reply) const;

  // Replaces the frames of a fragment of `steps` steps by pixels, uint8[steps,H,W,3]. Raw ones stay as they are.
  //   InvalidArgument: another format, invalid frames, or more or fewer than `steps`; names the field.
  absl::Status Draw(int steps, v1::FragmentMessage* message) const;

 private:
  // Draws the frames of `steps` scene records.
  absl::Status DrawScenes(int steps, std::string* frames) const;

  const size_t frame_bytes_;
  std::shared_ptr<const Renderer> renderer_;  // null: it draws no scenes
};

}  // namespace craftfleet
