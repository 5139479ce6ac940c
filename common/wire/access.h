// Who may watch, work and steer: the one place where calls are let in or refused.

#ifndef CRAFTFLEET_COMMON_WIRE_ACCESS_H_
#define CRAFTFLEET_COMMON_WIRE_ACCESS_H_

#include <memory>
#include <optional>
#include <string>
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

// Applies an access file, which may change while it is in use. A version with errors is logged and leaves the former
// in force. Thread-safe.
class AccessControl {
 public:
  // Errors of the file as it is now.
  static absl::StatusOr<std::shared_ptr<AccessControl>> Create(const std::string& path);

  // As CheckAccess; refusals are logged. The error's message is fit for the caller: it gives no reason away.
  absl::Status Check(const Caller& caller, absl::string_view path) ABSL_LOCKS_EXCLUDED(mu_);

 private:
  explicit AccessControl(const std::string& path) : file_(path, &clock_) {}
  absl::Status Load(absl::string_view text) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);

  RealClock clock_;
  LimitedLog log_{&clock_};
  Mutex mu_;
  WatchedFile file_ ABSL_GUARDED_BY(mu_);
  v1::Access access_ ABSL_GUARDED_BY(mu_);
};

// Asks `access` about each call that comes in over a listener's credentials.
std::shared_ptr<grpc::AuthMetadataProcessor> MakeAccessProcessor(std::shared_ptr<AccessControl> access);

}  // namespace craftfleet::wire

#endif  // CRAFTFLEET_COMMON_WIRE_ACCESS_H_
