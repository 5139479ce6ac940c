// A learner that misbehaves.

#pragma once

#include <atomic>

#include "craftfleet/v1/learner.grpc.pb.h"

namespace craftfleet {

enum class LearnerMisdeed {
  kSilent,    // accepts every call and answers none
  kLying,     // one field of each reply is invalid
  kFlooding,  // valid permits, and endless weights of 2 GiB
};

// Thread-safe.
class BadLearnerService : public v1::LearnerService::Service {
 public:
  explicit BadLearnerService(LearnerMisdeed misdeed) : misdeed_(misdeed) {}

  grpc::Status Join(grpc::ServerContext* context, const v1::JoinRequest* request, v1::JoinReply* reply) override;
  grpc::Status Play(grpc::ServerContext* context,
                    grpc::ServerReaderWriter<v1::LearnerMessage, v1::ActorMessage>* stream) override;
  grpc::Status GetWeights(grpc::ServerContext* context, const v1::WeightsRequest* request,
                          grpc::ServerWriter<v1::WeightsChunk>* writer) override;
  grpc::Status GetSnapshot(grpc::ServerContext* context, const v1::SnapshotRequest* request,
                           v1::SnapshotReply* reply) override;
  grpc::Status Announce(grpc::ServerContext* context, const v1::Announcement* request,
                        v1::AnnounceReply* reply) override;

 private:
  void AnswerRequest(const v1::PermitRequest& request, v1::PermitReply* reply);
  // If this learner is silent: waits until the caller has disconnected, and returns true.
  bool Ignored(const grpc::ServerContext& context) const;

  const LearnerMisdeed misdeed_;
  std::atomic<int> joined_{0};
  std::atomic<int> asked_{0};
};

}  // namespace craftfleet
