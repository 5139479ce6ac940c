// Why TLS handshakes of clients fail, for the log: gRPC tells it to nobody but its own log.

#ifndef CRAFTFLEET_COMMON_WIRE_HANDSHAKE_LOG_H_
#define CRAFTFLEET_COMMON_WIRE_HANDSHAKE_LOG_H_

#include <string>

#include <absl/strings/string_view.h>

namespace craftfleet::wire {

// From now on failed handshakes of this process' listeners are logged as warnings, not more than a few each ten
// seconds; whatever else gRPC's log says is dropped. Idempotent, thread-safe.
void LogFailedHandshakes();

// A client at `address` has connected: failed handshakes soon after this name it.
void NoteConnection(absl::string_view address);

// What a line of gRPC's log about a failed handshake means, in words for the log. Empty: it is about something else.
std::string ExplainHandshake(absl::string_view line);

}  // namespace craftfleet::wire

#endif  // CRAFTFLEET_COMMON_WIRE_HANDSHAKE_LOG_H_
