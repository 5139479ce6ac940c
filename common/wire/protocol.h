// What two processes must agree on before they work together.

#ifndef CRAFTFLEET_COMMON_WIRE_PROTOCOL_H_
#define CRAFTFLEET_COMMON_WIRE_PROTOCOL_H_

#include <cstddef>

#include <absl/status/status.h>
#include <absl/strings/string_view.h>

namespace craftfleet::wire {

// Raised with every change of the wire that an older process would misread.
inline constexpr int kProtocolVersion = 2;

// Largest message taken in, bytes: a fragment of 4096 frames of 72x72 with room to spare.
inline constexpr int kMaxMessageBytes = 96 << 20;

// Largest text by which a process tells others of itself: a name, an address, a CPU.
inline constexpr size_t kMaxTextBytes = 512;

// InvalidArgument, naming the field, unless `text` is printable ASCII of at most kMaxTextBytes: it is kept, logged and
// shown on terminals.
absl::Status CheckText(absl::string_view field, absl::string_view text);

// What a process says of itself in a handshake; an empty digest or run id matches any.
struct Handshake {
  int protocol_version = kProtocolVersion;
  absl::string_view run_id;
  absl::string_view texture_digest;
};

// FailedPrecondition when `theirs` can't work with `ours`; the message says what to change. `us` and `them` are names
// like "learner" and "actor".
absl::Status CheckHandshake(absl::string_view us, const Handshake& ours, absl::string_view them,
                            const Handshake& theirs);

}  // namespace craftfleet::wire

#endif  // CRAFTFLEET_COMMON_WIRE_PROTOCOL_H_
