// The flags of programs that connect to another or listen.

#pragma once

#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>

#include "common/wire/channel.h"
#include "common/wire/security.h"
#include "common/wire/server.h"

namespace craftfleet::wire {

// channel_flags.cc: --tls_cert, --tls_key, --tls_ca and --tls_server_name, of every program.
TlsFiles TlsFilesFromFlags();
// The security that they configure. Errors as ChannelSecurity::Create.
absl::StatusOr<ChannelSecurity> ChannelSecurityFromFlags();
// Connects with it to the process at --address=`address`. Errors call the process `who`.
//   InvalidArgument: a bad address or file.   Unavailable: no answer within 3 s.
absl::StatusOr<Endpoint> ConnectToProcess(absl::string_view who, absl::string_view address);

// server_flags.cc: --insecure, --access_file and --max_buffered_mb, of those that listen: on `address`, their --listen.
Server::Options ServerOptionsFromFlags(absl::string_view address);

}  // namespace craftfleet::wire
