// Pictures as what they were made from: the server writes a record of each, some hundred bytes instead of 12,288, and
// the receiver draws the same bytes from it. The night's noise is drawn from the game's random stream. The first record
// of a night has the state of the stream before the picture; the next ones say how many words were drawn in between.
//
// A record, all numbers little-endian, for a view of n cells:
//   flags      uint8: bit 0 the player sleeps, bit 1 the stream's state follows; others 0
//   daylight   float64, 0..1
//   inventory  uint8[8]: two items each, the first in the low half; 0..9
//   ground     uint8[n]: a sprite that is a material's, or 130 for the outside
//   things     count uint16, 0..n; of each, by ascending cell: cell uint16, sprite uint8, which is no material's
//   noise      only if daylight < 0.5. With bit 1: position uint16, 0..624; words uint32[624]. Without: words
//              drawn since the record before: uint16, 0..kMaxWordsBetween

#pragma once

#include <cstdint>
#include <string>

#include <absl/status/status.h>
#include <absl/strings/string_view.h>
#include <absl/types/span.h>

#include "envserver/render/renderer.h"
#include "envserver/render/scene.h"
#include "envserver/world/random_stream.h"

namespace craftfleet {

// If the game drew more words between two pictures, the record has the stream's state: skipping takes time.
inline constexpr int kMaxWordsBetween = 60 * RandomStream::kStateWords;

// Writes the records of one game. Thread-compatible.
class SceneWriter {
 public:
  // The next record can be read without those before. To be called also when the game's stream was replaced, as by a
  // reset.
  void Restart() { drawn_ = kUnknown; }
  // Appends the record of a picture to `out`. `stream`: the game's, before the picture's noise is drawn.
  void Append(const Renderer& renderer, const Scene& scene, const RandomStream& stream, std::string* out);

 private:
  static constexpr int64_t kUnknown = -1;

  // RandomStream::drawn() after the last noise; kUnknown: the reader does not have the stream.
  int64_t drawn_ = kUnknown;
};

// Draws pictures from records of one game, in the order in which they were written. Thread-compatible.
class SceneReader {
 public:
  // Forgets the records so far.
  void Restart() { has_stream_ = false; }
  // Draws the picture of the record at the beginning of `bytes`, and removes the record from `bytes`.
  //   InvalidArgument: the record is cut, has a value out of range, or needs a record before; names the field.
  absl::Status Draw(const Renderer& renderer, absl::string_view* bytes, absl::Span<uint8_t> frame);

 private:
  // Brings the stream to where it was before the picture.
  absl::Status ReadNoise(bool has_state, absl::string_view* bytes);

  bool has_stream_ = false;
  RandomStream stream_;  // after the last noise
  Scene scene_;          // reused
};

}  // namespace craftfleet
