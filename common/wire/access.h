// Who may watch, play, serve and steer: the one place where calls are let in or refused.

#ifndef CRAFTFLEET_COMMON_WIRE_ACCESS_H_
#define CRAFTFLEET_COMMON_WIRE_ACCESS_H_

#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>

#include "common/clock.h"
#include "common/limited_log.h"
#include "common/mutex.h"
#include "common/watched_file.h"
#include "craftfleet/v1/access.pb.h"

namespace grpc {
class AuthMetadataProcessor;
class ServerContextBase;
}  // namespace grpc

namespace craftfleet::wire {

// What a client shows with a call.
struct Caller {
  std::vector<std::string> certificate_names;  // common name and alternative names; empty: no certificate
  std::optional<std::string> token;
  std::string program;  // what it says it is, for the log
};

// The right that calls of `path` ("/package.Service/Method") need; RIGHT_UNSPECIFIED: none (health). What is not known
// needs STEER, so that no service is open by oversight.
v1::Right RightFor(absl::string_view path);

// The access file's contents.
//   InvalidArgument: "<filename>:<line>:<column>: ..." or what is wrong with a client.
absl::StatusOr<v1::Access> ParseAccess(absl::string_view text, absl::string_view filename);

// Ok if `caller` may call `path`.
//   Unauthenticated: it shows nothing that is listed.   PermissionDenied: it is known, without that right.
//   The message says why and who it was; it is for the log, not for the caller.
absl::Status CheckAccess(const v1::Access& access, const Caller& caller, absl::string_view path);

// Who `caller` is to others: the names in its certificate and those of the clients of `access` that it fits. The same
// for every certificate with these names and every token of such a client, so that both can be renewed. Empty: nobody
// in particular.
std::string Identity(const v1::Access& access, const Caller& caller);

// Applies an access file, which may change while it is in use. A version with errors is logged and leaves the former
// in force. The file is read on a thread of its own: no call waits for a slow disk. Thread-safe.
class AccessControl {
 public:
  // Errors of the file as it is now.
  static absl::StatusOr<std::shared_ptr<AccessControl>> Create(const std::string& path);

  // As CheckAccess; refusals are logged. The error's message is fit for the caller: it gives no reason away.
  absl::Status Check(const Caller& caller, absl::string_view path);
  // Identity of who made the call of `context`.
  std::string Identify(const grpc::ServerContextBase& context) const;

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
  LimitedLog log_{&clock_};
  std::shared_ptr<Snapshot> snapshot_;
  std::unique_ptr<FileWatch> watch_;
};

// Identity of who made the call of `context` where there is no access file: by its certificate. Empty without one.
std::string IdentifyByCertificate(const grpc::ServerContextBase& context);

// Asks `access` about each call that comes in over a listener's credentials.
std::shared_ptr<grpc::AuthMetadataProcessor> MakeAccessProcessor(std::shared_ptr<AccessControl> access);

}  // namespace craftfleet::wire

#endif  // CRAFTFLEET_COMMON_WIRE_ACCESS_H_
