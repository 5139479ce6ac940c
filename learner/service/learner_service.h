// The learner's gRPC service for workers: converts, checks and delegates. Calls that wait for the learner or for their
// client have no thread each, since every actor nearly always has some: gRPC calls them back on a few threads of its
// own.

#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <string>

#include "common/base/clock.h"
#include "common/base/types.h"
#include "common/base/waiting_calls.h"
#include "common/telemetry/limited_log.h"
#include "common/wire/access.h"
#include "common/wire/convert.h"
#include "common/wire/stream_watch.h"
#include "craftfleet/v1/learner.grpc.pb.h"
#include "craftfleet/v1/status.pb.h"
#include "learner/scheduling/worker_registry.h"
#include "learner/service/fragment_intake.h"
#include "learner/training/fragments/fragment_collector.h"
#include "learner/training/fragments/fragment_frames.h"
#include "learner/training/weight_store.h"

namespace craftfleet {

// Implements LearnerService (learner.proto). Thread-safe. The pointers must outlive it; the registry has no other
// observer.
class LearnerServiceImpl final : public v1::LearnerService::CallbackService {
 public:
  struct Options {
    std::string run_id;
    int64_t epoch = 0;     // number of the learner's start
    v1::RunConfig config;  // complete (CompleteConfig)
    std::string texture_digest;
    wire::FragmentShape shape;
    absl::Duration lease;  // of actors; sent to them in JoinReply
    // Identifies workers; null: they are identified by certificate.
    std::shared_ptr<const wire::AccessControl> access = nullptr;
    // How long a stream's client may take to send the next message, and to accept an answer or a chunk of weights.
    absl::Duration message_timeout = wire::StreamWatch::kRequest;
    absl::Duration reply_timeout = wire::StreamWatch::kTakesReply;
    // Streams at once from one address, of which each actor has one, and one more while it downloads weights; further
    // ones: RESOURCE_EXHAUSTED.
    int max_streams_per_client = 2 * WorkerTable::Options().max_names_per_client;
  };

  LearnerServiceImpl(const Options& options, WorkerRegistry* registry, WeightStore* weights, FragmentQueue* fragments);
  ~LearnerServiceImpl() override;

  grpc::ServerUnaryReactor* Join(grpc::CallbackServerContext* context, const v1::JoinRequest* request,
                                 v1::JoinReply* reply) override;
  grpc::ServerBidiReactor<v1::ActorMessage, v1::LearnerMessage>* Play(grpc::CallbackServerContext* context) override;
  grpc::ServerWriteReactor<v1::WeightsChunk>* GetWeights(grpc::CallbackServerContext* context,
                                                         const v1::WeightsRequest* request) override;
  grpc::ServerUnaryReactor* GetSnapshot(grpc::CallbackServerContext* context, const v1::SnapshotRequest* request,
                                        v1::SnapshotReply* reply) override;
  grpc::ServerUnaryReactor* FinishEvaluation(grpc::CallbackServerContext* context, const v1::EvaluationResult* request,
                                             v1::EvaluationReply* reply) override;
  grpc::ServerUnaryReactor* Announce(grpc::CallbackServerContext* context, const v1::Announcement* request,
                                     v1::AnnounceReply* reply) override;
  grpc::ServerUnaryReactor* Leave(grpc::CallbackServerContext* context, const v1::LeaveRequest* request,
                                  v1::LeaveReply* reply) override;

  // Adds fragment counts, and the workers as peers. Returns all workers, for sums.
  std::vector<WorkerRegistry::WorkerInfo> FillStatus(v1::StatusReply* reply) const;

 private:
  class ActorStream;
  class WeightStream;

  absl::Status CheckEpoch(int64_t epoch) const;
  // Aborted: another epoch.   InvalidArgument: a field is out of its range; logged.
  absl::Status CheckPermits(const grpc::ServerContextBase& context, const v1::PermitRequest& request);
  // Converts the request for the registry.
  WorkerRegistry::PermitRequest ToRequest(WorkerClient client, const v1::PermitRequest& request) const;
  void FillPermits(const WorkerRegistry::PermitReply& given, v1::PermitReply* reply) const;
  v1::EvaluationTask ToProto(const EvaluationTable::Task& task) const;
  // Whether the client of a stream may go on.   Errors as wire::AccessControl::Check.
  absl::Status CheckAllowed(const grpc::ServerContextBase& context) const;
  // FragmentIntake::Receive; logs what was refused.
  absl::StatusOr<v1::FragmentVerdict> Receive(const grpc::ServerContextBase& context, v1::FragmentMessage* message);
  WorkerClient ClientOf(const grpc::ServerContextBase& context) const;
  // Checks that the client may call as actor `name`.   InvalidArgument: `name` is not a valid name.   Others as
  // WorkerRegistry::UseName, logged.
  absl::Status NameActor(const grpc::ServerContextBase& context, absl::string_view name);
  // Logs `status` if the client was refused because of its name. Returns `status`.
  absl::Status LogRefusal(const WorkerClient& client, absl::Status status);
  // Logs why a call that names a worker was refused; few lines, however often a client calls, under whatever names.
  void WarnRefused(const grpc::ServerContextBase& context, absl::string_view text);

  const Options options_;
  const FragmentFrames frames_;
  WorkerRegistry* const registry_;
  WeightStore* const weights_;
  FragmentIntake intake_;

  std::atomic<int64_t> last_stream_{0};  // of Play; they are numbered from 1

  RealClock clock_;
  LimitedLog refusals_;
  LimitedLog worker_refusals_;
  wire::StreamWatch streams_;
  WaitingCalls waiting_for_permits_;
};

}  // namespace craftfleet
