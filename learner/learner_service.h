// The gRPC face of the learner: converts and hands over.

#ifndef CRAFTFLEET_LEARNER_LEARNER_SERVICE_H_
#define CRAFTFLEET_LEARNER_LEARNER_SERVICE_H_

#include <atomic>
#include <cstdint>
#include <memory>
#include <string>

#include "common/clock.h"
#include "common/closable_queue.h"
#include "common/limited_log.h"
#include "common/types.h"
#include "common/wire/access.h"
#include "common/wire/convert.h"
#include "common/wire/stream_watch.h"
#include "craftfleet/v1/learner.grpc.pb.h"
#include "craftfleet/v1/status.pb.h"
#include "learner/build_check.h"
#include "learner/evaluation_book.h"
#include "learner/fleet_book.h"
#include "learner/lane_ledger.h"
#include "learner/name_book.h"
#include "learner/server_registry.h"
#include "learner/weight_store.h"

namespace craftfleet {

// Accepted fragments on their way to the trainer; permits bound their number.
using FragmentQueue = ClosableQueue<Fragment>;

// Thread-safe. The pointers must outlive it.
class LearnerServiceImpl final : public v1::LearnerService::Service {
 public:
  struct Options {
    std::string run_id;
    int64_t epoch = 0;     // start number of the learner
    v1::RunConfig config;  // resolved
    std::string texture_digest;
    wire::FragmentShape shape;
    absl::Duration lease;            // told to actors
    BuildCheck::Options build = {};  // what workers are compared with
    std::shared_ptr<const wire::AccessControl> access =
        nullptr;  // by which workers are told apart; null: by certificate
  };

  LearnerServiceImpl(const Options& options, LaneLedger* ledger, WeightStore* weights, FragmentQueue* fragments,
                     EvaluationBook* evaluations, ServerRegistry* env_servers, FleetBook* fleet);

  grpc::Status Join(grpc::ServerContext* context, const v1::JoinRequest* request, v1::JoinReply* reply) override;
  grpc::Status GetPermits(grpc::ServerContext* context, const v1::PermitRequest* request,
                          v1::PermitReply* reply) override;
  grpc::Status PushFragments(grpc::ServerContext* context,
                             grpc::ServerReaderWriter<v1::FragmentVerdict, v1::FragmentMessage>* stream) override;
  grpc::Status GetWeights(grpc::ServerContext* context, const v1::WeightsRequest* request,
                          grpc::ServerWriter<v1::WeightsChunk>* writer) override;
  grpc::Status GetSnapshot(grpc::ServerContext* context, const v1::SnapshotRequest* request,
                           v1::SnapshotReply* reply) override;
  grpc::Status FinishEvaluation(grpc::ServerContext* context, const v1::EvaluationResult* request,
                                v1::EvaluationReply* reply) override;
  grpc::Status Announce(grpc::ServerContext* context, const v1::Announcement* request,
                        v1::AnnounceReply* reply) override;
  grpc::Status Leave(grpc::ServerContext* context, const v1::LeaveRequest* request, v1::LeaveReply* reply) override;

  // Counts of fragments and the actors as peers.
  void FillStatus(v1::StatusReply* reply) const;

 private:
  absl::Status CheckEpoch(int64_t epoch) const;
  void TellEnvServers(const v1::PermitRequest& request, v1::PermitReply* reply);
  void OfferEvaluation(const v1::PermitRequest& request, v1::PermitReply* reply);
  absl::StatusOr<WeightStore::Weights> FindWeights(const v1::WeightsRequest& request) const;
  absl::StatusOr<v1::FragmentVerdict::Verdict> TakeIn(v1::FragmentMessage* message);
  // Who calls speaks as `name` of `kind`.   InvalidArgument: no name.   Others as NameBook::Use, logged.
  absl::Status Name(const grpc::ServerContext& context, absl::string_view kind, absl::string_view name);

  const Options options_;
  LaneLedger* const ledger_;
  WeightStore* const weights_;
  FragmentQueue* const fragments_;
  EvaluationBook* const evaluations_;
  ServerRegistry* const env_servers_;
  FleetBook* const fleet_;

  std::atomic<int64_t> accepted_{0};
  std::atomic<int64_t> duplicates_{0};
  std::atomic<int64_t> expired_{0};
  std::atomic<int64_t> rejected_{0};

  RealClock clock_;
  NameBook names_;
  BuildCheck builds_;
  LimitedLog refusals_;
  wire::StreamWatch streams_;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_LEARNER_SERVICE_H_
