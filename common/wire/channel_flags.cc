#include <string>

#include <absl/flags/flag.h>

#include "common/base/status_macros.h"
#include "common/wire/wire_flags.h"

ABSL_FLAG(std::string, tls_cert, "",
          "PEM file with the certificate (chain) of this process; requires --tls_key.\n"
          "All TLS files may be replaced at any time: new connections use their current content");
ABSL_FLAG(std::string, tls_key, "", "PEM file with the private key of --tls_cert");
ABSL_FLAG(std::string, tls_ca, "",
          "PEM file with the authority that must have signed the certificates of peers; connections use TLS then.\n"
          "A process that listens with --tls_cert requires it, and a certificate from each client");
ABSL_FLAG(std::string, tls_server_name, "",
          "name that the certificates of servers must have [the host of their address]");

namespace craftfleet::wire {

TlsFiles TlsFilesFromFlags() {
  return {absl::GetFlag(FLAGS_tls_cert), absl::GetFlag(FLAGS_tls_key), absl::GetFlag(FLAGS_tls_ca)};
}

absl::StatusOr<ChannelSecurity> ChannelSecurityFromFlags() {
  return ChannelSecurity::Create({TlsFilesFromFlags(), absl::GetFlag(FLAGS_tls_server_name)});
}

absl::StatusOr<Endpoint> ConnectToProcess(absl::string_view who, absl::string_view address) {
  CRAFTFLEET_RETURN_IF_ERROR(CheckAddress("address", address));
  CRAFTFLEET_ASSIGN_OR_RETURN(const ChannelSecurity security, ChannelSecurityFromFlags());
  Endpoint process = Connect(address, security);
  CRAFTFLEET_RETURN_IF_ERROR(WaitUntilConnected(who, process, absl::Seconds(3)));
  return process;
}

}  // namespace craftfleet::wire
