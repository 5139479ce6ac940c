#include "common/wire/channel_flags.h"

#include <string>

#include <absl/flags/flag.h>

ABSL_FLAG(std::string, tls_cert, "",
          "PEM file with the certificate (chain) that this process shows to others; --tls_key wanted beside it.\n"
          "This file and the others may be replaced at any time: new connections use what is in them then");
ABSL_FLAG(std::string, tls_key, "", "PEM file with the private key of --tls_cert");
ABSL_FLAG(std::string, tls_ca, "",
          "PEM file with the authority from which others' certificates must come: to connect is by TLS then;\n"
          "a process that listens with --tls_cert wants a certificate from each client");
ABSL_FLAG(std::string, tls_server_name, "",
          "name that the certificates of those connected to must carry [the host of their address]");
ABSL_FLAG(std::string, token_file, "", "file with a token to show to those connected to; wants --tls_ca");

namespace craftfleet::wire {

TlsFiles TlsFilesFromFlags() {
  return {absl::GetFlag(FLAGS_tls_cert), absl::GetFlag(FLAGS_tls_key), absl::GetFlag(FLAGS_tls_ca)};
}

absl::StatusOr<ChannelSecurity> ChannelSecurityFromFlags() {
  return ChannelSecurity::Create(
      {TlsFilesFromFlags(), absl::GetFlag(FLAGS_tls_server_name), absl::GetFlag(FLAGS_token_file)});
}

}  // namespace craftfleet::wire
