#include "common/wire/channel_flags.h"

#include <string>

#include <absl/flags/flag.h>

ABSL_FLAG(std::string, tls_cert, "",
          "PEM file with the certificate (chain) of this process; requires --tls_key.\n"
          "All TLS files may be replaced at any time: new connections use their current content");
ABSL_FLAG(std::string, tls_key, "", "PEM file with the private key of --tls_cert");
ABSL_FLAG(std::string, tls_ca, "",
          "PEM file with the authority that must have signed the certificates of peers; connections use TLS then.\n"
          "A process that listens with --tls_cert requires a certificate from each client");
ABSL_FLAG(std::string, tls_server_name, "",
          "name that the certificates of servers must have [the host of their address]");
ABSL_FLAG(std::string, token_file, "", "file with a token to send to servers; requires --tls_ca");

namespace craftfleet::wire {

TlsFiles TlsFilesFromFlags() {
  return {absl::GetFlag(FLAGS_tls_cert), absl::GetFlag(FLAGS_tls_key), absl::GetFlag(FLAGS_tls_ca)};
}

absl::StatusOr<ChannelSecurity> ChannelSecurityFromFlags() {
  return ChannelSecurity::Create(
      {TlsFilesFromFlags(), absl::GetFlag(FLAGS_tls_server_name), absl::GetFlag(FLAGS_token_file)});
}

}  // namespace craftfleet::wire
