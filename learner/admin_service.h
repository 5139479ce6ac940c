// Steering: what `craftfleet admin` asks of the learner.

#ifndef CRAFTFLEET_LEARNER_ADMIN_SERVICE_H_
#define CRAFTFLEET_LEARNER_ADMIN_SERVICE_H_

#include <functional>
#include <string>

#include <absl/status/status.h>
#include <absl/strings/string_view.h>

#include "craftfleet/v1/admin.grpc.pb.h"
#include "learner/checkpoint_requests.h"
#include "learner/evaluation_book.h"
#include "learner/lane_ledger.h"
#include "learner/server_registry.h"

namespace craftfleet {

// Thread-safe. What is steered outlives it. Every call is logged, with who made it.
class AdminServiceImpl final : public v1::AdminService::Service {
 public:
  struct Parts {
    CheckpointRequests* checkpoints;
    LaneLedger* ledger;
    EvaluationBook* evaluations;
    ServerRegistry* env_servers;
    std::function<void()> stop;  // of the learner; returns at once
  };

  explicit AdminServiceImpl(Parts parts) : parts_(std::move(parts)) {}

  grpc::Status Checkpoint(grpc::ServerContext* context, const v1::CheckpointRequest* request,
                          v1::CheckpointReply* reply) override;
  grpc::Status Pause(grpc::ServerContext* context, const v1::PauseRequest* request, v1::PauseReply* reply) override;
  grpc::Status Resume(grpc::ServerContext* context, const v1::ResumeRequest* request, v1::ResumeReply* reply) override;
  grpc::Status Drain(grpc::ServerContext* context, const v1::DrainRequest* request, v1::DrainReply* reply) override;
  grpc::Status Stop(grpc::ServerContext* context, const v1::StopRequest* request, v1::StopReply* reply) override;

 private:
  // Ok when `done`; looks again and again.
  //   DeadlineExceeded, with `otherwise`: the call's deadline came first.   Cancelled: the client left.
  static absl::Status WaitFor(grpc::ServerContext* context, const std::function<bool()>& done,
                              absl::string_view otherwise);
  absl::Status DrainActor(grpc::ServerContext* context, const std::string& actor);
  absl::Status DrainServer(grpc::ServerContext* context, const std::string& server);
  // NotFound, with all workers that there are.
  absl::Status NoSuchWorker(absl::string_view name) const;

  const Parts parts_;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_ADMIN_SERVICE_H_
