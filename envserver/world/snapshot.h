// The state of a game as bytes and back: little-endian, versioned, with a checksum. Restoring validates everything.

#pragma once

#include <cstddef>
#include <string>

#include <absl/status/status.h>
#include <absl/strings/string_view.h>

#include "envserver/world/random_stream.h"
#include "envserver/world/state.h"

namespace craftfleet {

// See World::Save and World::Restore. The layout, after the 8 bytes "CFWORLD" and version and a crc32c of what follows:
//   options       EncodeOptions() of snapshot.cc
//   game          seed, episode, step int64; reward double; last health uint8
//   player        sleeping uint8; inventory uint8[16]; achievements int32[22]; hunger, thirst, fatigue, recover double;
//                 last health uint8
//   stream        position uint16; words uint32[624]
//   cells         uint8[width][height]: material + 16 * (variant + 1)
//   known chunks  count uint16; indices uint16
//   objects       entries int64; count uint16; of each type uint8; variant int8; health, x, y, facing x, y
//                 int16; counter int32; entered int64
inline constexpr size_t kSavedObjectBytes = 24;  // of each object

std::string SaveState(const WorldState& state, const RandomStream& stream);
absl::Status RestoreState(absl::string_view snapshot, WorldState* state);

}  // namespace craftfleet
