#include "common/wire/security.h"

#include <fcntl.h>
#include <sys/mman.h>
#include <unistd.h>

#include <array>
#include <cstddef>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <thread>
#include <utility>
#include <vector>

#include <absl/strings/match.h>
#include <absl/strings/str_cat.h>
#include <absl/time/clock.h>
#include <grpcpp/security/credentials.h>
#include <grpcpp/security/server_credentials.h>
#include <grpcpp/security/tls_certificate_provider.h>
#include <grpcpp/security/tls_credentials_options.h>

#include "common/base/mutex.h"
#include "common/base/status_macros.h"
#include "common/io/watched_file.h"
#include "common/telemetry/log.h"
#include "common/wire/certificates.h"

namespace craftfleet::wire {
namespace {

using grpc::experimental::FileWatcherCertificateProvider;

constexpr unsigned int kLookEverySeconds = 1;
constexpr size_t kFiles = 3;

using Paths = std::array<std::string, kFiles>;     // certificate, key, authorities; empty: none
using Contents = std::array<std::string, kFiles>;  // of these

absl::Status Check(const Paths& paths, const Contents& contents) {
  if (!paths[0].empty()) CRAFTFLEET_RETURN_IF_ERROR(CheckKeyPair(paths[0], contents[0], paths[1], contents[1]));
  return paths[2].empty() ? absl::OkStatus() : CheckAuthorities(paths[2], contents[2]);
}

// A descriptor of a new file in memory; -1: failed.
int MakeFile(const std::string& contents) {
  const int file = memfd_create("craftfleet-certificate", MFD_CLOEXEC);
  if (file < 0) return -1;
  for (size_t written = 0; written < contents.size();) {
    const ssize_t count = write(file, contents.data() + written, contents.size() - written);
    if (count <= 0) {
      close(file);
      return -1;
    }
    written += static_cast<size_t>(count);
  }
  return file;
}

// Thread-safe.
class Copies {
 public:
  explicit Copies(Paths paths) : paths_(std::move(paths)) {
    for (const std::string& path : paths_) files_.emplace_back(path);
  }

  // Whether the files could be read, are valid and were copied.
  bool Begin() ABSL_LOCKS_EXCLUDED(mu_) {
    const MutexLock lock(&mu_);
    for (size_t i = 0; i < kFiles; ++i) {
      if (paths_[i].empty()) continue;
      std::optional<std::string> contents = files_[i].ReadIfChanged();
      if (!contents.has_value()) return false;
      contents_[i] = *std::move(contents);
    }
    if (!Check(paths_, contents_).ok()) return false;
    for (size_t i = 0; i < kFiles; ++i) {
      if (paths_[i].empty()) continue;
      descriptors_[i] = MakeFile(contents_[i]);
      copies_[i] = absl::StrCat("/proc/self/fd/", descriptors_[i]);
      if (descriptors_[i] < 0 || access(copies_[i].c_str(), R_OK) != 0) return false;
    }
    return true;
  }

  // Of the copies. Constant after Begin.
  TlsFiles files() const { return {copies_[0], copies_[1], copies_[2]}; }

  // Copies the files if they have changed and are valid.
  void Look() ABSL_LOCKS_EXCLUDED(mu_) {
    const MutexLock lock(&mu_);
    for (size_t i = 0; i < kFiles; ++i) {
      if (paths_[i].empty()) continue;
      std::optional<std::string> contents = files_[i].ReadIfChanged();
      if (!contents.has_value() || *contents == contents_[i]) continue;
      contents_[i] = *std::move(contents);
      looks_ = 1;
    }
    if (looks_ == 0) return;
    if (const absl::Status valid = Check(paths_, contents_); !valid.ok()) {
      // Not at the first look, which may fall between the replacement of two files.
      if (looks_++ == 2) LogError("%s; the former certificates remain in use", valid.message());
      return;
    }
    looks_ = 0;
    for (size_t i = 0; i < kFiles; ++i) {
      if (!paths_[i].empty()) Replace(i);
    }
  }

 private:
  // At once: a reader gets the old file or the new one.
  void Replace(size_t i) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) {
    const int file = MakeFile(contents_[i]);
    if (file < 0) return LogError("%s cannot be copied; the former certificates remain in use", paths_[i]);
    dup3(file, descriptors_[i], O_CLOEXEC);
    close(file);
  }

  const Paths paths_;
  Paths copies_;
  Mutex mu_;
  std::vector<WatchedFile> files_ ABSL_GUARDED_BY(mu_);
  Contents contents_ ABSL_GUARDED_BY(mu_);                                   // as last read
  std::array<int, kFiles> descriptors_ ABSL_GUARDED_BY(mu_) = {-1, -1, -1};  // of the copies
  int looks_ ABSL_GUARDED_BY(mu_) = 0;                                       // at contents that are not copied yet
};

// The paths of copies of `files` in this process' memory, of those files that are named. They follow the files within a
// second, but only to contents that are valid together: gRPC's own watcher (1.51) aborts the process if it finds an
// empty file, and refuses all connections while a certificate and its key do not fit. Other contents are logged. If the
// files are not valid now, or the system has no files in memory, these are `files` themselves.
//
// A copy lives as long as the process, since nobody knows until when gRPC reads it. Thread-safe.
TlsFiles CopiesInMemory(const TlsFiles& files) {
  static auto* const mu = new Mutex;
  static auto* const all = new std::map<Paths, Copies*>;
  const Paths paths = {files.certificate, files.key, files.authorities};
  const MutexLock lock(mu);
  if (const auto found = all->find(paths); found != all->end()) {
    found->second->Look();
    return found->second->files();
  }
  auto made = std::make_unique<Copies>(paths);
  if (!made->Begin()) return files;
  Copies* const copies = made.release();
  all->emplace(paths, copies);
  std::thread([copies] {
    while (true) {
      absl::SleepFor(absl::Seconds(kLookEverySeconds));
      copies->Look();
    }
  }).detach();
  return copies->files();
}

std::shared_ptr<FileWatcherCertificateProvider> Watch(const TlsFiles& files) {
  const TlsFiles copies = CopiesInMemory(files);
  return std::make_shared<FileWatcherCertificateProvider>(copies.key, copies.certificate, copies.authorities,
                                                          kLookEverySeconds);
}

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
    if (!options.server_name.empty()) return absl::InvalidArgumentError("--tls_server_name requires --tls_ca");
    return security;
  }
  grpc::experimental::TlsChannelCredentialsOptions tls;
  tls.set_certificate_provider(Watch(options.files));
  tls.watch_root_certs();
  if (!options.files.certificate.empty()) tls.watch_identity_key_cert_pairs();
  security.credentials_ = grpc::experimental::TlsCredentials(tls);
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
    case absl::StatusCode::kPermissionDenied:
      if (!absl::StrContains(text, "not allowed")) break;  // not about rights
      absl::StrAppend(&text, ": its --access_file gives this process' certificate no right to this");
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
    return "what listens there does not speak TLS: start it with --tls_cert, --tls_key and --tls_ca, "
           "or leave --tls_ca out here";
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
    return at_once ? "it closed the connection at once: if it speaks TLS, give --tls_ca, --tls_cert and --tls_key"
                   : std::string(error);
  }
  if (files.certificate.empty()) {
    return "TLS: it closed the connection: it may want a certificate: give --tls_cert and --tls_key";
  }
  const std::string problem = CertificateProblem(files.certificate, files.authorities, absl::Now());
  return absl::StrCat("TLS: it closed the connection: it may have refused --tls_cert=", files.certificate,
                      problem.empty() ? "; its log says why" : ": " + problem);
}

std::shared_ptr<grpc::ServerCredentials> TlsListenerCredentials(const TlsFiles& files) {
  grpc::experimental::TlsServerCredentialsOptions tls(Watch(files));
  tls.watch_identity_key_cert_pairs();
  tls.watch_root_certs();
  tls.set_cert_request_type(GRPC_SSL_REQUEST_AND_REQUIRE_CLIENT_CERTIFICATE_AND_VERIFY);
  return grpc::experimental::TlsServerCredentials(tls);
}

}  // namespace craftfleet::wire
