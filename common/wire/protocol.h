// The handshake: what two processes check before they work together.

#pragma once

#include <cstddef>

#include <absl/status/status.h>
#include <absl/strings/string_view.h>

#include "common/base/range_check.h"

namespace craftfleet::wire {

// Increased with every change of the protocol that an older process would misread.
inline constexpr int kProtocolVersion = 3;

// Largest accepted message, bytes: a fragment of 4096 frames of 72x72 with room to spare.
inline constexpr int kMaxMessageBytes = 96 << 20;
using craftfleet::kMaxCount;

// Largest text in which a process describes itself (a name, an address, a CPU), bytes.
inline constexpr size_t kMaxTextBytes = 512;

// InvalidArgument, naming the field, unless `text` is printable ASCII of at most kMaxTextBytes: such texts are stored,
// logged and shown on terminals.
absl::Status CheckText(absl::string_view field, absl::string_view text);

// A process in a handshake; an empty digest or run id matches any.
struct Handshake {
  int protocol_version = kProtocolVersion;
  absl::string_view run_id;
  absl::string_view texture_digest;
};

// FailedPrecondition when `theirs` is incompatible with `ours`; the message says what to change. `us` and `them` are
// names like "learner" and "actor".
absl::Status CheckHandshake(absl::string_view us, const Handshake& ours, absl::string_view them,
                            const Handshake& theirs);

}  // namespace craftfleet::wire
