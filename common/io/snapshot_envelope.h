// The envelope around a game's snapshot. It lets programs without the game check that a snapshot is complete, within
// the size limit and of the right environment.

#pragma once

#include <cstddef>
#include <cstdint>
#include <string>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>

namespace craftfleet {

// Largest snapshot in bytes, with its envelope. A game takes 8 KB, and 24 bytes for each object: usually a few hundred,
// at most one on each of 64x64 cells. A smaller bound would be one that a valid game can grow beyond, and whoever
// played its lane could send no fragment.
inline constexpr size_t kMaxSnapshotBytes = 112 << 10;

// The environment's digest in an envelope: over the world's canonical name (EnvName::WorldName) and the number of steps
// after which an episode is truncated. Options of the picture are not included: a snapshot contains no picture.
uint64_t EnvDigest(absl::string_view world_name, int64_t length);

// Puts `game`, the bytes of a saved game, into an envelope: magic "CFSNAP", version uint16, digest uint64, size of the
// game uint32, CRC-32C of the game uint32, the game; all little-endian.
std::string SealSnapshot(uint64_t env_digest, absl::string_view game);

// The game inside an envelope; the view points into `sealed`.
//   InvalidArgument: too large, no envelope, or another version, environment, size or checksum; the message names what
//   was found and what was expected.
absl::StatusOr<absl::string_view> OpenSnapshot(uint64_t env_digest, absl::string_view sealed);

// The status of OpenSnapshot; OK for an empty snapshot, which is a game that has not begun.
absl::Status CheckSnapshot(uint64_t env_digest, absl::string_view sealed);

}  // namespace craftfleet
