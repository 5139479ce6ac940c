#include <cstdint>
#include <string>

#include <absl/flags/flag.h>

#include "common/wire/wire_flags.h"

ABSL_FLAG(bool, insecure, false, "allow --listen beyond this host without TLS");
ABSL_FLAG(std::string, access_file, "",
          "file with the rights of clients (watch, play, serve, steer), in protobuf text format (access.proto);\n"
          "requires --tls_cert; read again when it changes [an authenticated client has all rights]");
ABSL_FLAG(int32_t, max_buffered_mb, 512,
          "memory for incoming and outgoing messages, MiB, 128..1000000; calls beyond it are refused for the moment");

namespace craftfleet::wire {

Server::Options ServerOptionsFromFlags(absl::string_view address) {
  Server::Options options;
  options.address = std::string(address);
  options.insecure = absl::GetFlag(FLAGS_insecure);
  options.files = TlsFilesFromFlags();
  options.access_file = absl::GetFlag(FLAGS_access_file);
  options.max_buffered_mb = absl::GetFlag(FLAGS_max_buffered_mb);
  return options;
}

}  // namespace craftfleet::wire
