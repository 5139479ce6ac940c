// Calls to the learner, each with a deadline. Errors name the learner's address.

#ifndef CRAFTFLEET_ACTOR_LEARNER_CLIENT_H_
#define CRAFTFLEET_ACTOR_LEARNER_CLIENT_H_

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

#include "actor/permit_book.h"
#include "common/mutex.h"
#include "common/types.h"
#include "common/wire/channel.h"
#include "craftfleet/v1/learner.grpc.pb.h"

namespace craftfleet {

// Thread-safe.
//   Unavailable, DeadlineExceeded: the learner can't be reached or does not answer: try again.
//   Cancelled: Cancel was called.   Others as learner.proto says for each call.
class LearnerClient {
 public:
  explicit LearnerClient(wire::Endpoint learner);

  absl::StatusOr<v1::JoinReply> Join(const v1::JoinRequest& request) const;
  absl::StatusOr<v1::PermitReply> GetPermits(const v1::PermitRequest& request) const;
  // Where the fragments of `permits`, all of one epoch, begin; in their order. Asked for side by side: the learner may
  // be far. `state_size` is that of the agent (AgentSpec). A lane of which the learner has nothing that could be played
  // has DataLoss in its place.
  absl::StatusOr<std::vector<absl::StatusOr<LaneSnapshot>>> GetSnapshots(absl::Span<const HeldPermit> permits,
                                                                         int state_size) const;
  void Leave(const std::string& actor) const;

  // Ends every call under way and to come, but for Leave and PushFragments. From any thread.
  void Cancel() ABSL_LOCKS_EXCLUDED(mu_);

  // The weights of `version` or a later one: (version, safetensors bytes).
  absl::StatusOr<std::pair<int64_t, std::string>> GetWeights(int64_t version) const;

  // The weights to play evaluation task `id` with.
  absl::StatusOr<std::string> GetEvaluationWeights(int64_t id) const;
  absl::Status FinishEvaluation(const v1::EvaluationResult& result) const;

  // A stream for fragments; `context` ends it.
  std::unique_ptr<grpc::ClientReaderWriter<v1::FragmentMessage, v1::FragmentVerdict>> PushFragments(
      grpc::ClientContext* context) const {
    return stub_->PushFragments(context);
  }

  const std::string& name() const { return name_; }

 private:
  class Call;
  struct SnapshotCall;

  // As GetSnapshots, of so few that all are asked for at once.
  absl::Status AppendSnapshots(absl::Span<const HeldPermit> permits, int state_size,
                               std::vector<absl::StatusOr<LaneSnapshot>>* snapshots) const;
  // The error of a unary call or a download that has ended.
  absl::Status FromCall(const grpc::Status& status) const ABSL_LOCKS_EXCLUDED(mu_);

  absl::StatusOr<std::pair<int64_t, std::string>> ReceiveWeights(const v1::WeightsRequest& request) const;

  const wire::Endpoint learner_;
  const std::string name_;  // "learner ADDRESS"
  const std::unique_ptr<v1::LearnerService::Stub> stub_;

  mutable Mutex mu_;
  mutable std::set<grpc::ClientContext*> calls_ ABSL_GUARDED_BY(mu_);  // under way
  bool cancelled_ ABSL_GUARDED_BY(mu_) = false;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_ACTOR_LEARNER_CLIENT_H_
