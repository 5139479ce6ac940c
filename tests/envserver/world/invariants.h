// The invariants of a world between steps, and snapshots that get past their checksum.

#pragma once

#include <cstddef>
#include <cstdint>
#include <string>

#include <absl/strings/string_view.h>

#include "common/base/crc32c.h"
#include "envserver/world/world.h"

namespace craftfleet {

// The first broken invariant, or empty.
std::string BrokenInvariant(const World& world);

inline constexpr size_t kSnapshotBodyAt = 12;  // behind the checksum

// `snapshot` with a correct checksum, if it is long enough to have one.
inline std::string Sealed(std::string snapshot) {
  if (snapshot.size() < kSnapshotBodyAt) return snapshot;
  const uint32_t checksum = Crc32c(absl::string_view(snapshot).substr(kSnapshotBodyAt));
  for (size_t i = 0; i < 4; ++i) snapshot[kSnapshotBodyAt - 4 + i] = static_cast<char>(checksum >> (8 * i));
  return snapshot;
}

}  // namespace craftfleet
