// The flags of every program that connects to another: --tls_cert, --tls_key, --tls_ca, --tls_server_name,
// --token_file.

#pragma once

#include <absl/status/statusor.h>

#include "common/wire/security.h"

namespace craftfleet::wire {

TlsFiles TlsFilesFromFlags();

// The security that the flags configure. Errors as ChannelSecurity::Create.
absl::StatusOr<ChannelSecurity> ChannelSecurityFromFlags();

}  // namespace craftfleet::wire
