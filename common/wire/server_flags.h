// The flags of every program that listens: --insecure, --tls_client_certs, --access_file, --max_buffered_mb, and those
// of channel_flags.h.

#pragma once

#include <absl/strings/string_view.h>

#include "common/wire/server.h"

namespace craftfleet::wire {

// The server options from the flags, listening on `address` (the program's --listen).
Server::Options ServerOptionsFromFlags(absl::string_view address);

}  // namespace craftfleet::wire
