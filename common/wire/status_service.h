// The status endpoint of every process.

#ifndef CRAFTFLEET_COMMON_WIRE_STATUS_SERVICE_H_
#define CRAFTFLEET_COMMON_WIRE_STATUS_SERVICE_H_

#include <functional>
#include <string>

#include <absl/strings/string_view.h>
#include <absl/time/time.h>

#include "craftfleet/v1/status.grpc.pb.h"

namespace craftfleet::wire {

// Fills in version and uptime and asks `fill` for the rest. Thread-safe if `fill` is.
class StatusServiceImpl final : public v1::StatusService::Service {
 public:
  using Fill = std::function<void(v1::StatusReply*)>;

  StatusServiceImpl(absl::string_view role, Fill fill);

  grpc::Status GetStatus(grpc::ServerContext* context, const v1::StatusRequest* request,
                         v1::StatusReply* reply) override;

 private:
  const std::string role_;
  const Fill fill_;
  const absl::Time start_;
};

void AddMetric(absl::string_view name, double value, absl::string_view unit, v1::StatusReply* reply);

}  // namespace craftfleet::wire

#endif  // CRAFTFLEET_COMMON_WIRE_STATUS_SERVICE_H_
