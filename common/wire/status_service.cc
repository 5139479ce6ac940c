#include "common/wire/status_service.h"

#include <utility>

#include <absl/strings/str_cat.h>
#include <absl/time/clock.h>

#include "common/version.h"

namespace craftfleet::wire {

StatusServiceImpl::StatusServiceImpl(absl::string_view role, Fill fill)
    : role_(role), fill_(std::move(fill)), start_(absl::Now()) {}

grpc::Status StatusServiceImpl::GetStatus(grpc::ServerContext* /*context*/, const v1::StatusRequest* /*request*/,
                                          v1::StatusReply* reply) {
  reply->set_role(role_);
  reply->set_version(absl::StrCat(ProgramVersion(), " (", GitRevision(), ")"));
  reply->set_uptime_s(absl::ToDoubleSeconds(absl::Now() - start_));
  fill_(reply);
  return grpc::Status::OK;
}

void AddMetric(absl::string_view name, double value, absl::string_view unit, v1::StatusReply* reply) {
  v1::Metric* metric = reply->add_metrics();
  metric->set_name(std::string(name));
  metric->set_value(value);
  metric->set_unit(std::string(unit));
}

}  // namespace craftfleet::wire
