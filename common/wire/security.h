// TLS: the certificates that a process presents to its peers and requires from them.

#pragma once

#include <memory>
#include <string>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>

namespace grpc {
class ChannelCredentials;
class ServerCredentials;
}  // namespace grpc

namespace craftfleet::wire {

// PEM files. All may be replaced while the program runs: within two seconds new connections use the new content; open
// connections are not affected. While the files are missing, invalid or don't match, the former content remains in use.
struct TlsFiles {
  std::string certificate;  // --tls_cert: presented to peers, with intermediate certificates
  std::string key;          // --tls_key: the certificate's
  std::string authorities;  // --tls_ca: authorities whose certificates are accepted

  bool empty() const { return certificate.empty() && key.empty() && authorities.empty(); }
  // Checks the files; warns once about the dates of each.   InvalidArgument: one is invalid, or a flag is missing.
  // Others: one can't be read.   All name flag and file.
  absl::Status Validate() const;
};

// The client's side. Thread-safe; copies share the credentials.
class ChannelSecurity {
 public:
  struct Options {
    TlsFiles files;           // without authorities: no TLS
    std::string server_name;  // name required in servers' certificates; empty: the host of the address
  };

  // No TLS.
  ChannelSecurity() = default;
  //   InvalidArgument: options that don't go together; names the flags.   Others as TlsFiles::Validate.
  static absl::StatusOr<ChannelSecurity> Create(const Options& options);

  bool tls() const { return !options_.files.authorities.empty(); }
  const std::string& server_name() const { return options_.server_name; }
  // A copy that requires `name` in servers' certificates, unless Create was given a name.
  ChannelSecurity ForServer(absl::string_view name) const;
  // The credentials for a channel; insecure ones without TLS.
  std::shared_ptr<grpc::ChannelCredentials> Credentials() const;

  // Adds advice to `error`, gRPC's status of a call to `address`, if it failed for lack of a connection or of rights.
  // Other errors are returned unchanged.
  absl::Status Explain(const absl::Status& error, absl::string_view address) const;

 private:
  std::string ExplainConnection(absl::string_view error, absl::string_view address) const;

  Options options_;
  std::shared_ptr<grpc::ChannelCredentials> credentials_;
};

// The server's side: TLS with `files`, which must include certificate and key. Clients must present a certificate from
// one of the authorities.
std::shared_ptr<grpc::ServerCredentials> TlsListenerCredentials(const TlsFiles& files);

}  // namespace craftfleet::wire
