#include "common/wire/grpc_status.h"

#include <string>

#include <absl/strings/str_cat.h>

#include "common/base/printable.h"
#include "common/telemetry/log.h"

namespace craftfleet::wire {

static_assert(static_cast<int>(absl::StatusCode::kUnavailable) == static_cast<int>(grpc::StatusCode::UNAVAILABLE));
static_assert(static_cast<int>(absl::StatusCode::kUnauthenticated) ==
              static_cast<int>(grpc::StatusCode::UNAUTHENTICATED));

namespace {

// The message travels in HTTP/2 headers, which peers limit to 8 KiB.
constexpr size_t kMaxStatusBytes = 1024;

// gRPC leaves the message empty if the server does not know the method.
std::string Message(const grpc::Status& status) {
  if (!status.error_message().empty()) return status.error_message();
  if (status.error_code() == grpc::StatusCode::UNIMPLEMENTED) {
    return "does not know this call: another program, or an older one, listens there";
  }
  return absl::StatusCodeToString(static_cast<absl::StatusCode>(status.error_code()));
}

}  // namespace

grpc::Status ToGrpc(const absl::Status& status) {
  if (status.ok()) return grpc::Status::OK;
  return {static_cast<grpc::StatusCode>(status.code()), Shortened(status.message(), kMaxStatusBytes)};
}

absl::Status FromGrpc(const grpc::Status& status, absl::string_view context) {
  if (status.ok()) return absl::OkStatus();
  // Programs print it: a peer must not send a terminal more than text.
  const std::string message = Printable(Shortened(Message(status), kMaxStatusBytes));
  return {static_cast<absl::StatusCode>(status.error_code()), absl::StrCat(context, ": ", message)};
}

}  // namespace craftfleet::wire
