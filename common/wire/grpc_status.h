// absl::Status <-> grpc::Status; the codes have the same numbers.

#pragma once

#include <absl/status/status.h>
#include <absl/strings/string_view.h>
#include <grpcpp/support/status.h>

namespace craftfleet::wire {

grpc::Status ToGrpc(const absl::Status& status);

// Prefixes the message of a failed status with `context` ("learner 10.0.0.1:50051: ...").
absl::Status FromGrpc(const grpc::Status& status, absl::string_view context);

}  // namespace craftfleet::wire
