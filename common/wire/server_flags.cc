#include "common/wire/server_flags.h"

#include <cstdint>
#include <string>

#include <absl/flags/flag.h>

#include "common/wire/channel_flags.h"

ABSL_FLAG(bool, insecure, false, "allow --listen beyond this host without TLS");
ABSL_FLAG(bool, tls_client_certs, true, "with --tls_cert and --tls_ca: want a certificate of each client");
ABSL_FLAG(std::string, access_file, "",
          "who may watch, play, serve and steer, in protobuf text format (access.proto); wants --tls_cert;\n"
          "read again when it changes [who gets in may do all]");
ABSL_FLAG(
    std::string, health_listen, "",
    "address of a second port, plain and with nothing but grpc.health.v1 on it, HOST:PORT, for probes that speak\n"
    "no TLS [none]");
ABSL_FLAG(int32_t, max_connections_per_client, 1024, "connections from one address at once, 1..65536");
ABSL_FLAG(int32_t, max_buffered_mb, 512,
          "memory for messages on their way in and out, 128..1000000; beyond it calls are refused for the moment");

namespace craftfleet::wire {

Server::Options ServerOptionsFromFlags(absl::string_view address) {
  Server::Options options;
  options.address = std::string(address);
  options.insecure = absl::GetFlag(FLAGS_insecure);
  options.files = TlsFilesFromFlags();
  options.ask_clients = absl::GetFlag(FLAGS_tls_client_certs);
  options.access_file = absl::GetFlag(FLAGS_access_file);
  options.health_address = absl::GetFlag(FLAGS_health_listen);
  options.max_connections_per_client = absl::GetFlag(FLAGS_max_connections_per_client);
  options.max_buffered_mb = absl::GetFlag(FLAGS_max_buffered_mb);
  return options;
}

}  // namespace craftfleet::wire
