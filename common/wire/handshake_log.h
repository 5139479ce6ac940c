// Logs why TLS handshakes of clients fail: gRPC reports it only in its own log.

#ifndef CRAFTFLEET_COMMON_WIRE_HANDSHAKE_LOG_H_
#define CRAFTFLEET_COMMON_WIRE_HANDSHAKE_LOG_H_

#include <string>

#include <absl/strings/string_view.h>

namespace craftfleet::wire {

// From now on failed handshakes of this process's listeners are logged as warnings, rate-limited (LimitedLog); other
// lines of gRPC's log are dropped. Idempotent, thread-safe.
void LogFailedHandshakes();

// Records that a client at `address` has connected: handshakes that fail within two seconds are logged with it.
void NoteConnection(absl::string_view address);

// Translates a line of gRPC's log about a failed handshake into a message for operators. Empty: another kind of line.
std::string ExplainHandshake(absl::string_view line);

}  // namespace craftfleet::wire

#endif  // CRAFTFLEET_COMMON_WIRE_HANDSHAKE_LOG_H_
