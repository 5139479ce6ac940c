// Calls to the learner, each with a deadline. Errors name the learner's address.

#pragma once

#include <cstdint>
#include <memory>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/time/time.h>
#include <absl/types/span.h>

#include "actor/permit_tracker.h"
#include "common/base/mutex.h"
#include "common/base/types.h"
#include "common/wire/channel.h"
#include "craftfleet/v1/learner.grpc.pb.h"

namespace craftfleet {

// Thread-safe.
//   Unavailable, DeadlineExceeded: the learner can't be reached or does not answer; retry.
//   Cancelled: Cancel was called.   Others as learner.proto states for each call.
class LearnerClient {
 public:
  explicit LearnerClient(wire::Endpoint learner);

  absl::StatusOr<v1::JoinReply> Join(const v1::JoinRequest& request) const;
  // Fetches the snapshots before the fragments of `permits`, which are of one epoch; returns them in the same order.
  // The requests run in parallel, since the learner may be far away. `state_size` is that of the agent (AgentSpec). An
  // invalid snapshot is returned as InvalidArgument.
  absl::StatusOr<std::vector<absl::StatusOr<LaneSnapshot>>> GetSnapshots(absl::Span<const HeldPermit> permits,
                                                                         int state_size) const;
  // Tells the learner that the actor leaves. Errors are ignored: without this call, the lease expires.
  void Leave(const std::string& actor) const;

  // Ends all current and future calls except Leave and Play. May be called from any thread.
  void Cancel() ABSL_LOCKS_EXCLUDED(mu_);

  // Fetches the weights of `version` or a later one: (version, safetensors bytes).
  //   DataLoss: the learner sends more than `max_bytes`, or parts that do not fit together.
  absl::StatusOr<std::pair<int64_t, std::string>> GetWeights(int64_t version, int64_t max_bytes) const;

  // Fetches the weights (safetensors) for evaluation task `id`.   Errors as GetWeights.
  absl::StatusOr<std::string> GetEvaluationWeights(int64_t id, int64_t max_bytes) const;
  absl::Status FinishEvaluation(const v1::EvaluationResult& result) const;

  // Opens a stream for permits and fragments. Cancelling `context` ends it.
  std::unique_ptr<grpc::ClientReaderWriter<v1::ActorMessage, v1::LearnerMessage>> Play(
      grpc::ClientContext* context) const {
    return stub_->Play(context);
  }

  // Converts the status of a finished call, and adds the learner's name.
  absl::Status FromCall(const grpc::Status& status) const ABSL_LOCKS_EXCLUDED(mu_);

  const std::string& name() const { return name_; }

 private:
  class Call;
  struct SnapshotCall;

  // As GetSnapshots, for few enough permits to be requested all at once.
  absl::Status AppendSnapshots(absl::Span<const HeldPermit> permits, int state_size,
                               std::vector<absl::StatusOr<LaneSnapshot>>* snapshots) const;
  absl::StatusOr<std::pair<int64_t, std::string>> ReceiveWeights(const v1::WeightsRequest& request,
                                                                 int64_t max_bytes) const;

  const wire::Endpoint learner_;
  const std::string name_;  // "learner ADDRESS"
  const std::unique_ptr<v1::LearnerService::Stub> stub_;

  mutable Mutex mu_;
  mutable std::set<grpc::ClientContext*> calls_ ABSL_GUARDED_BY(mu_);  // under way
  bool cancelled_ ABSL_GUARDED_BY(mu_) = false;
};

}  // namespace craftfleet
