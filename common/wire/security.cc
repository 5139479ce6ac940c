#include "common/wire/security.h"

#include <algorithm>
#include <cstddef>
#include <map>
#include <memory>
#include <set>
#include <utility>

#include <absl/strings/ascii.h>
#include <absl/strings/match.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/time/clock.h>
#include <grpcpp/security/credentials.h>
#include <grpcpp/security/server_credentials.h>
#include <grpcpp/security/tls_certificate_provider.h>
#include <grpcpp/security/tls_credentials_options.h>

#include "common/base/mutex.h"
#include "common/base/status_macros.h"
#include "common/base/status_prefix.h"
#include "common/io/files.h"
#include "common/io/watched_file.h"
#include "common/telemetry/log.h"
#include "common/wire/certificate_copies.h"
#include "common/wire/certificates.h"

namespace craftfleet::wire {
namespace {

using grpc::experimental::FileWatcherCertificateProvider;

constexpr unsigned int kLookEverySeconds = 1;
constexpr size_t kMaxTokenBytes = 4096;  // peers limit headers to 8 KiB
constexpr absl::string_view kWanted = "want one line of printable characters, at most 4096";

// HTTP/2 cannot carry others: with such a token all calls would fail.
bool IsToken(absl::string_view text) {
  return !text.empty() && text.size() <= kMaxTokenBytes && std::all_of(text.begin(), text.end(), absl::ascii_isprint);
}

std::shared_ptr<FileWatcherCertificateProvider> Watch(const TlsFiles& files) {
  const TlsFiles copies = CopiesInMemory(files);
  return std::make_shared<FileWatcherCertificateProvider>(copies.key, copies.certificate, copies.authorities,
                                                          kLookEverySeconds);
}

// The current token of a token file. Shared by the calls and the thread that reads the file. Thread-safe.
class Token {
 public:
  std::string Get() const ABSL_LOCKS_EXCLUDED(mu_) {
    const MutexLock lock(&mu_);
    return token_;
  }
  // Returns false if `contents` is not a token; the former one stays.
  bool Set(const std::string& contents) ABSL_LOCKS_EXCLUDED(mu_) {
    std::string token(absl::StripAsciiWhitespace(contents));
    if (!IsToken(token)) return false;
    const MutexLock lock(&mu_);
    token_ = std::move(token);
    return true;
  }

 private:
  mutable Mutex mu_;
  std::string token_ ABSL_GUARDED_BY(mu_);
};

// Adds the newest token of a file to each call; no call waits for the file.
class TokenPlugin : public grpc::MetadataCredentialsPlugin {
 public:
  //   InvalidArgument: there is no token in the file.   Others: it can't be read.
  static absl::StatusOr<std::unique_ptr<TokenPlugin>> Create(const std::string& path) {
    auto token = std::make_shared<Token>();
    CRAFTFLEET_ASSIGN_OR_RETURN(std::string contents, WithPrefix("--token_file", ReadFile(path)));
    if (!token->Set(contents)) {
      return absl::InvalidArgumentError(absl::StrCat("--token_file=", path, " is not a token, ", kWanted));
    }
    return std::unique_ptr<TokenPlugin>(new TokenPlugin(path, std::move(contents), std::move(token)));
  }

  bool IsBlocking() const override { return false; }

  grpc::Status GetMetadata(grpc::string_ref /*service_url*/, grpc::string_ref /*method*/,
                           const grpc::AuthContext& /*context*/,
                           std::multimap<std::string, std::string>* metadata) override {
    metadata->insert({"authorization", absl::StrCat("Bearer ", token_->Get())});
    return grpc::Status::OK;
  }

 private:
  TokenPlugin(const std::string& path, std::string contents, std::shared_ptr<Token> token)
      : token_(std::move(token)), watch_(path, std::move(contents), [token = token_, path](const std::string& now) {
          if (token->Set(now)) {
            LogInfo("--token_file=%s was read again", path);
          } else {
            LogError("--token_file=%s: %s; the former token remains in use", path, kWanted);
          }
        }) {}

  const std::shared_ptr<Token> token_;
  const FileWatch watch_;
};

// Whether this is the first call with `certificate`: a server and each of its channels validate the same files.
bool IsFirstWarning(const std::string& certificate) {
  static Mutex mu;
  static std::set<std::string>& warned = *new std::set<std::string>;
  const MutexLock lock(&mu);
  return warned.insert(certificate).second;
}

}  // namespace

absl::Status TlsFiles::Validate() const {
  if (certificate.empty() != key.empty()) {
    return absl::InvalidArgumentError(certificate.empty() ? "--tls_key requires --tls_cert"
                                                          : "--tls_cert requires --tls_key");
  }
  if (!authorities.empty()) CRAFTFLEET_RETURN_IF_ERROR(CheckAuthorities(authorities));
  if (certificate.empty()) return absl::OkStatus();
  CRAFTFLEET_RETURN_IF_ERROR(CheckKeyPair(certificate, key));
  const std::string problem = CertificateProblem(certificate, "", absl::Now());
  if (!problem.empty() && IsFirstWarning(certificate)) {
    LogWarning("%s: peers will refuse it until the file is replaced", problem);
  }
  return absl::OkStatus();
}

absl::StatusOr<ChannelSecurity> ChannelSecurity::Create(const Options& options) {
  CRAFTFLEET_RETURN_IF_ERROR(options.files.Validate());
  ChannelSecurity security;
  security.options_ = options;
  if (!security.tls()) {
    if (!options.token_file.empty()) {
      return absl::InvalidArgumentError(
          "--token_file requires --tls_ca: without TLS the token could be read in transit");
    }
    if (!options.server_name.empty()) return absl::InvalidArgumentError("--tls_server_name requires --tls_ca");
    return security;
  }
  grpc::experimental::TlsChannelCredentialsOptions tls;
  tls.set_certificate_provider(Watch(options.files));
  tls.watch_root_certs();
  if (!options.files.certificate.empty()) tls.watch_identity_key_cert_pairs();
  security.credentials_ = grpc::experimental::TlsCredentials(tls);
  if (!options.token_file.empty()) {
    CRAFTFLEET_ASSIGN_OR_RETURN(std::unique_ptr<TokenPlugin> token, TokenPlugin::Create(options.token_file));
    security.credentials_ =
        grpc::CompositeChannelCredentials(security.credentials_, grpc::MetadataCredentialsFromPlugin(std::move(token)));
  }
  return security;
}

ChannelSecurity ChannelSecurity::ForServer(absl::string_view name) const {
  ChannelSecurity security = *this;
  if (tls() && security.options_.server_name.empty()) security.options_.server_name = std::string(name);
  return security;
}

std::shared_ptr<grpc::ChannelCredentials> ChannelSecurity::Credentials() const {
  return tls() ? credentials_ : grpc::InsecureChannelCredentials();
}

absl::Status ChannelSecurity::Explain(const absl::Status& error, absl::string_view address) const {
  std::string text(error.message());
  switch (error.code()) {
    case absl::StatusCode::kUnavailable:
      text = ExplainConnection(error.message(), address);
      break;
    case absl::StatusCode::kUnauthenticated:
      absl::StrAppend(&text, options_.token_file.empty() ? ": it may want a token: give --token_file"
                                                         : ": check the token in --token_file=" + options_.token_file);
      break;
    case absl::StatusCode::kPermissionDenied:
      if (!absl::StrContains(text, "not allowed")) break;  // not about rights
      absl::StrAppend(&text, ": its --access_file gives this process' ",
                      options_.token_file.empty() ? "certificate" : "token or certificate", " no right to this");
      break;
    default:
      break;
  }
  return {error.code(), text};
}

std::string ChannelSecurity::ExplainConnection(absl::string_view error, absl::string_view address) const {
  const TlsFiles& files = options_.files;
  if (absl::StrContains(error, "Cancelling all calls")) return "it has stopped";
  if (absl::StrContains(error, "http1.x") || absl::StrContains(error, "parsing HTTP/2")) {
    return "what listens there speaks HTTP, not gRPC: is it the port of the metrics or of the page?";
  }
  if (absl::StrContains(error, "wrong version number")) {
    return "what listens there does not speak TLS: start it with --tls_cert and --tls_key, or leave --tls_ca out here";
  }
  if (absl::StrContains(error, "certificate verify failed")) {
    return absl::StrCat("TLS: its certificate is not from an authority in --tls_ca=", files.authorities,
                        ", or it has expired, or begins later than this host's clock says");
  }
  if (absl::StrContains(error, "erification")) {  // "Hostname Verification Check failed", in some spelling
    const std::string name(server_name().empty() ? address.substr(0, address.rfind(':')) : server_name());
    return absl::StrCat("TLS: its certificate is for another name than ", name,
                        ": check the address, or give the name it is for as --tls_server_name");
  }
  const bool closed = absl::StrContains(error, "Socket closed") || absl::StrContains(error, "onnection reset") ||
                      absl::StrContains(error, "Broken pipe");
  if (!closed) return std::string(error);
  if (!tls()) {
    // A peer that speaks TLS closes the connection before it is made; a later loss has another cause.
    const bool at_once = absl::StrContains(error, "failed to connect");
    return at_once ? "it closed the connection at once: if it speaks TLS, give --tls_ca" : std::string(error);
  }
  if (files.certificate.empty()) {
    return "TLS: it closed the connection: it may want a certificate: give --tls_cert and --tls_key";
  }
  const std::string problem = CertificateProblem(files.certificate, files.authorities, absl::Now());
  return absl::StrCat("TLS: it closed the connection: it may have refused --tls_cert=", files.certificate,
                      problem.empty() ? "; its log says why" : ": " + problem);
}

std::shared_ptr<grpc::ServerCredentials> TlsListenerCredentials(const TlsFiles& files, bool ask_clients) {
  TlsFiles watched = files;
  if (!ask_clients) watched.authorities.clear();
  grpc::experimental::TlsServerCredentialsOptions tls(Watch(watched));
  tls.watch_identity_key_cert_pairs();
  if (ask_clients) {
    tls.watch_root_certs();
    tls.set_cert_request_type(GRPC_SSL_REQUEST_AND_REQUIRE_CLIENT_CERTIFICATE_AND_VERIFY);
  }
  return grpc::experimental::TlsServerCredentials(tls);
}

}  // namespace craftfleet::wire
