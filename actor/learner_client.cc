#include "actor/learner_client.h"

#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>

#include "actor/learner_replies.h"
#include "common/base/status_macros.h"

namespace craftfleet {
namespace {

constexpr absl::Duration kCallTimeout = absl::Seconds(4);       // users should see an error within 5 s
constexpr absl::Duration kWeightsTimeout = absl::Seconds(120);  // half a gigabyte over a slow link
constexpr size_t kSnapshotsAtOnce = 32;                         // a connection may have 128 calls

}  // namespace

// The context of a call, registered so that Cancel can cancel it.
class LearnerClient::Call {
 public:
  Call(const LearnerClient* client, absl::Duration timeout) : client_(client) {
    wire::SetDeadline(&context_, timeout);
    const MutexLock lock(&client_->mu_);
    client_->calls_.insert(&context_);
    if (client_->cancelled_) context_.TryCancel();
  }
  ~Call() {
    const MutexLock lock(&client_->mu_);
    client_->calls_.erase(&context_);
  }
  grpc::ClientContext* context() { return &context_; }

 private:
  const LearnerClient* const client_;
  grpc::ClientContext context_;
};

LearnerClient::LearnerClient(wire::Endpoint learner)
    : learner_(std::move(learner)),
      name_(absl::StrCat("learner ", learner_.address)),
      stub_(v1::LearnerService::NewStub(learner_.channel)) {}

absl::Status LearnerClient::FromCall(const grpc::Status& status) const {
  if (status.error_code() == grpc::StatusCode::CANCELLED) {
    const MutexLock lock(&mu_);
    if (cancelled_) return absl::CancelledError("stopping");
    return absl::UnavailableError(name_ + ": it is stopping");
  }
  return wire::FromCall(status, name_, learner_);
}

absl::StatusOr<v1::JoinReply> LearnerClient::Join(const v1::JoinRequest& request) const {
  Call call(this, kCallTimeout);
  v1::JoinReply reply;
  const grpc::Status status = stub_->Join(call.context(), request, &reply);
  if (!status.ok()) return FromCall(status);
  return reply;
}

struct LearnerClient::SnapshotCall {
  explicit SnapshotCall(const LearnerClient* client) : call(client, kCallTimeout) {}

  Call call;
  v1::SnapshotReply reply;
  grpc::Status status;
  std::unique_ptr<grpc::ClientAsyncResponseReader<v1::SnapshotReply>> reader;
};

absl::StatusOr<std::vector<absl::StatusOr<LaneSnapshot>>> LearnerClient::GetSnapshots(
    absl::Span<const HeldPermit> permits, int state_size) const {
  std::vector<absl::StatusOr<LaneSnapshot>> snapshots;
  for (size_t first = 0; first < permits.size(); first += kSnapshotsAtOnce) {
    const absl::Span<const HeldPermit> some = permits.subspan(first, kSnapshotsAtOnce);
    CRAFTFLEET_RETURN_IF_ERROR(AppendSnapshots(some, state_size, &snapshots));
  }
  return snapshots;
}

absl::Status LearnerClient::AppendSnapshots(absl::Span<const HeldPermit> permits, int state_size,
                                            std::vector<absl::StatusOr<LaneSnapshot>>* snapshots) const {
  grpc::CompletionQueue answers;
  std::vector<std::unique_ptr<SnapshotCall>> calls;
  for (const HeldPermit& permit : permits) {
    v1::SnapshotRequest request;
    request.set_epoch(permit.epoch);
    request.set_lane(permit.lane);
    request.set_fragment(permit.fragment);
    SnapshotCall& call = *calls.emplace_back(std::make_unique<SnapshotCall>(this));
    call.reader = stub_->AsyncGetSnapshot(call.call.context(), request, &answers);
    call.reader->Finish(&call.reply, &call.status, &call);
  }
  // Receive all replies first, since the queue must be empty when it is destroyed.
  for (size_t i = 0; i < calls.size(); ++i) {
    void* tag = nullptr;
    bool ok = false;
    answers.Next(&tag, &ok);
  }
  for (size_t i = 0; i < calls.size(); ++i) {
    if (!calls[i]->status.ok()) return FromCall(calls[i]->status);
    snapshots->push_back(ReadSnapshot(&calls[i]->reply, state_size));
  }
  return absl::OkStatus();
}

void LearnerClient::Leave(const std::string& actor) const {
  grpc::ClientContext context;
  wire::SetDeadline(&context, absl::Seconds(1));
  v1::LeaveRequest request;
  request.set_actor(actor);
  v1::LeaveReply reply;
  // If the learner does not receive this, the lease expires.
  stub_->Leave(&context, request, &reply);
}

void LearnerClient::Cancel() {
  const MutexLock lock(&mu_);
  cancelled_ = true;
  for (grpc::ClientContext* call : calls_) call->TryCancel();
}

absl::StatusOr<std::pair<int64_t, std::string>> LearnerClient::GetWeights(int64_t version, int64_t max_bytes) const {
  v1::WeightsRequest request;
  request.set_at_least(version);
  return ReceiveWeights(request, max_bytes);
}

absl::StatusOr<std::string> LearnerClient::GetEvaluationWeights(int64_t id, int64_t max_bytes) const {
  v1::WeightsRequest request;
  request.set_evaluation(id);
  CRAFTFLEET_ASSIGN_OR_RETURN(auto weights, ReceiveWeights(request, max_bytes));
  return std::move(weights.second);
}

absl::Status LearnerClient::FinishEvaluation(const v1::EvaluationResult& result) const {
  Call call(this, kCallTimeout);
  v1::EvaluationReply reply;
  return FromCall(stub_->FinishEvaluation(call.context(), result, &reply));
}

absl::StatusOr<std::pair<int64_t, std::string>> LearnerClient::ReceiveWeights(const v1::WeightsRequest& request,
                                                                              int64_t max_bytes) const {
  Call call(this, kWeightsTimeout);
  const auto stream = stub_->GetWeights(call.context(), request);
  std::pair<int64_t, std::string> weights = {-1, ""};
  int64_t total_bytes = 0;
  v1::WeightsChunk chunk;
  absl::Status checked;
  while (checked.ok() && stream->Read(&chunk)) {
    checked =
        CheckWeightsChunk(chunk, max_bytes, weights.first, total_bytes, static_cast<int64_t>(weights.second.size()));
    weights.first = chunk.policy_version();
    total_bytes = chunk.total_bytes();
    if (!checked.ok()) continue;
    weights.second.reserve(total_bytes);  // growing would need twice as much
    weights.second.append(chunk.data());
  }
  if (!checked.ok()) call.context()->TryCancel();
  const grpc::Status status = stream->Finish();
  if (!checked.ok()) return absl::DataLossError(absl::StrCat(name_, ": ", checked.message()));
  if (!status.ok()) return FromCall(status);
  if (static_cast<int64_t>(weights.second.size()) != total_bytes) {
    return absl::DataLossError(
        absl::StrFormat("%s: %d bytes of weights, want %d", name_, weights.second.size(), total_bytes));
  }
  return weights;
}

}  // namespace craftfleet
