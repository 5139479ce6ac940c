// TLS, tokens and who they are checked for: what a process shows to others and what it wants to be shown.

#ifndef CRAFTFLEET_COMMON_WIRE_SECURITY_H_
#define CRAFTFLEET_COMMON_WIRE_SECURITY_H_

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

// PEM files. All may be replaced while the program runs: new connections use what they hold within two seconds,
// connections that stand go on. A certificate and its key are best replaced by one rename of their folder or a link to
// it: as long as they don't fit, new connections fail.
struct TlsFiles {
  std::string certificate;  // --tls_cert: shown to peers, with the chain below its authority
  std::string key;          // --tls_key: the certificate's
  std::string authorities;  // --tls_ca: whose certificates are accepted

  bool empty() const { return certificate.empty() && key.empty() && authorities.empty(); }
  // Reads the files.   InvalidArgument: one is missing or wrong; names flag and file.   Warns about dates.
  absl::Status Validate() const;
};

// The client's side. Thread-safe; copies share the credentials.
class ChannelSecurity {
 public:
  struct Options {
    TlsFiles files;           // without authorities: no TLS
    std::string server_name;  // that servers' certificates must carry; empty: the host of the address
    std::string token_file;   // bearer token to show with each call, read again when it changes; empty: none
  };

  // No TLS, no token.
  ChannelSecurity() = default;
  //   InvalidArgument: options that don't go together; names the flags.   Others as TlsFiles::Validate.
  static absl::StatusOr<ChannelSecurity> Create(const Options& options);

  bool tls() const { return !options_.files.authorities.empty(); }
  const std::string& server_name() const { return options_.server_name; }
  // The same, for servers whose certificates carry `name`, unless a name was given to Create.
  ChannelSecurity ForServer(absl::string_view name) const;
  // Of this process; insecure ones without TLS.
  std::shared_ptr<grpc::ChannelCredentials> Credentials() const;

  // `error`, what gRPC says about a call to `address` that failed for lack of a connection or of rights, in words that
  // tell what to check. Unchanged if it is about something else.
  absl::Status Explain(const absl::Status& error, absl::string_view address) const;

 private:
  std::string ExplainConnection(absl::string_view error, absl::string_view address) const;

  Options options_;
  std::shared_ptr<grpc::ChannelCredentials> credentials_;
};

// The listener's side: TLS with `files`, whose certificate and key must be there; clients must show a certificate if
// `ask_clients`, which wants authorities.
std::shared_ptr<grpc::ServerCredentials> TlsListenerCredentials(const TlsFiles& files, bool ask_clients);

}  // namespace craftfleet::wire

#endif  // CRAFTFLEET_COMMON_WIRE_SECURITY_H_
