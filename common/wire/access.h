// Authorization: which clients may watch, play, serve and steer. The only place that admits or refuses calls.

#pragma once

#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>

#include "common/base/clock.h"
#include "common/base/mutex.h"
#include "common/io/watched_file.h"
#include "common/telemetry/limited_log.h"
#include "craftfleet/v1/access.pb.h"

namespace grpc {
class AuthMetadataProcessor;
class ServerContextBase;
}  // namespace grpc

namespace craftfleet::wire {

// The credentials of a client's call: a process of the fleet has a certificate, a reader of the live page a token.
struct Caller {
  std::vector<std::string> certificate_names;  // common name and alternative names; empty: no certificate
  std::optional<std::string> token;
  std::string program;  // its user agent, for the log
};

// The right that calls of `path` ("/package.Service/Method") need; RIGHT_UNSPECIFIED: none (health). Unknown paths need
// STEER, so that no service is open by oversight.
v1::Right RightFor(absl::string_view path);

// Parses an access file.
//   InvalidArgument: "<filename>:<line>:<column>: ...", or the client and what is wrong with it.
absl::StatusOr<v1::Access> ParseAccess(absl::string_view text, absl::string_view filename);

// OK if `caller` may call `path`.
//   Unauthenticated: its token is not listed, or it has no credentials.   PermissionDenied: others without the right.
//   The message names the reason and the client; it is for the log, not for the caller.
absl::Status CheckAccess(const v1::Access& access, const Caller& caller, absl::string_view path);

// Applies an access file, which may change while it is in use. If a new version has errors, they are logged and the
// former one remains in effect. A thread of its own reads the file: no call waits for a slow disk. Thread-safe.
class AccessControl {
 public:
  // Errors: the file cannot be read, or as ParseAccess.
  static absl::StatusOr<std::shared_ptr<AccessControl>> Create(const std::string& path);

  // As CheckAccess; refusals are logged. The error's message is safe to send to the caller: it contains no reason.
  absl::Status Check(const Caller& caller, absl::string_view path) const;
  // The same for a stream that goes on, since the file may have changed after it began.
  absl::Status Check(const grpc::ServerContextBase& context, absl::string_view path) const;
  // Whether Check would return OK; logs nothing.
  bool Allows(const Caller& caller, absl::string_view path) const;

 private:
  // The file's last good version. Shared with the thread that reads it.
  class Snapshot {
   public:
    explicit Snapshot(v1::Access access) : access_(std::make_shared<const v1::Access>(std::move(access))) {}
    std::shared_ptr<const v1::Access> Get() const ABSL_LOCKS_EXCLUDED(mu_) {
      const MutexLock lock(&mu_);
      return access_;
    }
    void Set(v1::Access access) ABSL_LOCKS_EXCLUDED(mu_) {
      auto fresh = std::make_shared<const v1::Access>(std::move(access));
      const MutexLock lock(&mu_);
      access_.swap(fresh);
    }

   private:
    mutable Mutex mu_;
    std::shared_ptr<const v1::Access> access_ ABSL_GUARDED_BY(mu_);
  };

  AccessControl() = default;

  RealClock clock_;
  mutable LimitedLog log_{&clock_};
  std::shared_ptr<Snapshot> snapshot_;
  std::unique_ptr<FileWatch> watch_;
};

// The identity of the caller of `context`: the names in its certificate, which stay when it is renewed. Empty: the
// caller cannot be told apart from others.
std::string Identify(const grpc::ServerContextBase& context);

// Checks each call to a server with these credentials against `access`.
std::shared_ptr<grpc::AuthMetadataProcessor> MakeAccessProcessor(std::shared_ptr<AccessControl> access);

}  // namespace craftfleet::wire
