// Queries the status of a running process of the fleet.

#pragma once

#include <string>

#include <absl/status/statusor.h>
#include <absl/time/time.h>

#include "common/wire/channel.h"
#include "common/wire/grpc_status.h"
#include "craftfleet/v1/status.grpc.pb.h"
#include "tests/fakes/metric_of.h"

namespace craftfleet {

// Returns the status of the process at `address`. Errors are those of the call; DeadlineExceeded after 10 s.
inline absl::StatusOr<v1::StatusReply> AskStatus(const std::string& address) {
  const auto stub = v1::StatusService::NewStub(wire::Connect(address).channel);
  grpc::ClientContext context;
  wire::SetDeadline(&context, absl::Seconds(10));
  v1::StatusReply reply;
  const grpc::Status status = stub->GetStatus(&context, {}, &reply);
  if (!status.ok()) return wire::FromGrpc(status, address);
  return reply;
}

// The metric `name` of the process at `address`; -1: no answer, or no such metric.
inline double MetricOf(const std::string& address, const std::string& name) {
  const absl::StatusOr<v1::StatusReply> reply = AskStatus(address);
  return reply.ok() ? MetricOf(*reply, name) : -1;
}

}  // namespace craftfleet
