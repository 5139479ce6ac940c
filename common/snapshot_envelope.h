// The envelope in which a game's snapshot travels: who does not know games can tell whether one is whole, of bearable
// size and of the right environment.

#ifndef CRAFTFLEET_COMMON_SNAPSHOT_ENVELOPE_H_
#define CRAFTFLEET_COMMON_SNAPSHOT_ENVELOPE_H_

#include <cstddef>
#include <cstdint>
#include <string>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>

namespace craftfleet {

// Largest snapshot, bytes, envelope included: a game has 8 KB and 24 bytes an object, which are a few hundred.
inline constexpr size_t kMaxSnapshotBytes = 64 << 10;

// What an envelope says of the environment: of the world's canonical name (EnvName::WorldName) and of the steps after
// which an episode is truncated. Pictures don't count: a snapshot has none.
uint64_t EnvDigest(absl::string_view world_name, int64_t length);

// `game`, as a game saved itself, in an envelope: magic "CFSNAP", version uint16, digest uint64, size of the game
// uint32, CRC-32C of the game uint32, the game; all little-endian.
std::string SealSnapshot(uint64_t env_digest, absl::string_view game);

// Takes the game out of its envelope; it points into `sealed`.
//   InvalidArgument: too large, no envelope, or one of another version, environment, size or checksum; the message has
//   what was found and what was expected.
absl::StatusOr<absl::string_view> OpenSnapshot(uint64_t env_digest, absl::string_view sealed);

// Whether `bytes` begins as an envelope. Snapshots of version 0.1 had none.
bool HasEnvelope(absl::string_view bytes);

// The status of OpenSnapshot. An empty snapshot, a game that has not begun, is sound.
absl::Status CheckSnapshot(uint64_t env_digest, absl::string_view sealed);

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_SNAPSHOT_ENVELOPE_H_
