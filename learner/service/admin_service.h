// The service behind `craftfleet admin`.

#pragma once

#include <functional>
#include <string>

#include <absl/status/status.h>
#include <absl/strings/string_view.h>

#include "craftfleet/v1/admin.grpc.pb.h"
#include "learner/service/steering.h"

namespace craftfleet {

// Implements AdminService (admin.proto). Thread-safe; `steering` outlives it.
class AdminServiceImpl final : public v1::AdminService::Service {
 public:
  explicit AdminServiceImpl(Steering* steering) : steering_(steering) {}

  grpc::Status Checkpoint(grpc::ServerContext* context, const v1::CheckpointRequest* request,
                          v1::CheckpointReply* reply) override;
  grpc::Status Pause(grpc::ServerContext* context, const v1::PauseRequest* request, v1::PauseReply* reply) override;
  grpc::Status Resume(grpc::ServerContext* context, const v1::ResumeRequest* request, v1::ResumeReply* reply) override;
  grpc::Status Drain(grpc::ServerContext* context, const v1::DrainRequest* request, v1::DrainReply* reply) override;
  grpc::Status Undrain(grpc::ServerContext* context, const v1::UndrainRequest* request,
                       v1::UndrainReply* reply) override;
  grpc::Status Stop(grpc::ServerContext* context, const v1::StopRequest* request, v1::StopReply* reply) override;

 private:
  // Polls until `done` returns true.
  //   DeadlineExceeded, with message `otherwise`: the call's deadline passed.   Cancelled: the client disconnected.
  static absl::Status WaitFor(grpc::ServerContext* context, const std::function<bool()>& done,
                              absl::string_view otherwise);

  Steering* const steering_;
};

}  // namespace craftfleet
