// LearnerServiceImpl: downloads of weights.
#include <cstddef>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include <absl/strings/str_format.h>

#include "common/base/status_macros.h"
#include "common/wire/grpc_status.h"
#include "learner/service/learner_service.h"

namespace craftfleet {
namespace {

// Each download that waits for its client holds two chunks, and there may be thousands of downloads.
constexpr size_t kChunkBytes = 128u << 10;

}  // namespace

// One call of GetWeights: writes one chunk after the other. gRPC calls one method at a time, and OnDone last.
class LearnerServiceImpl::WeightStream final : public grpc::ServerWriteReactor<v1::WeightsChunk> {
 public:
  WeightStream(LearnerServiceImpl* service, grpc::CallbackServerContext* context)
      : service_(service), watched_(std::in_place, &service->streams_, context) {}

  void Start(const v1::WeightsRequest& request) {
    absl::Status status = watched_->admitted();
    if (status.ok()) status = Take(request);
    status.ok() ? WriteNext() : End(status);
  }

  void OnWriteDone(bool ok) override { ok ? WriteNext() : End(watched_->late()); }
  void OnDone() override { delete this; }

 private:
  // Frees the stream's place before the client learns that it has ended.
  void End(absl::Status status) {
    watched_.reset();
    Finish(wire::ToGrpc(status));
  }

  // The version is 0 of an evaluation's.
  //   Aborted: the evaluation is over.   DeadlineExceeded: the version is not available yet.
  absl::StatusOr<WeightStore::Weights> Find(const v1::WeightsRequest& request) const {
    if (request.evaluation() != 0) {
      std::shared_ptr<const PolicyWeights> weights = service_->registry_->evaluations()->Weights(request.evaluation());
      if (weights != nullptr) return WeightStore::Weights{0, std::move(weights), {}, {}};
      return absl::AbortedError(absl::StrFormat("evaluation task %d is over", request.evaluation()));
    }
    WeightStore::Weights weights = service_->weights_->Find(request.at_least());
    if (weights.weights != nullptr && weights.version >= request.at_least()) return weights;
    return absl::DeadlineExceededError(absl::StrFormat("policy version %d is not available yet, the latest is %d",
                                                       request.at_least(), weights.version));
  }

  // Prepares to write the weights.   Errors as Find and PolicyWeights::Bytes.
  absl::Status Take(const v1::WeightsRequest& request) {
    CRAFTFLEET_ASSIGN_OR_RETURN(const WeightStore::Weights found, Find(request));
    CRAFTFLEET_ASSIGN_OR_RETURN(bytes_, found.weights->Bytes());
    chunk_.set_policy_version(found.version);
    chunk_.set_total_bytes(static_cast<int64_t>(bytes_->size()));
    return absl::OkStatus();
  }

  void WriteNext() {
    if (sent_ >= bytes_->size()) return End(watched_->late());
    chunk_.mutable_data()->assign(*bytes_, sent_, kChunkBytes);
    sent_ += kChunkBytes;
    watched_->Await("weights to be taken", service_->options_.reply_timeout);
    StartWrite(&chunk_);
  }

  LearnerServiceImpl* const service_;
  std::optional<wire::StreamWatch::Stream> watched_;  // until the call ends
  std::shared_ptr<const std::string> bytes_;
  size_t sent_ = 0;
  v1::WeightsChunk chunk_;
};

grpc::ServerWriteReactor<v1::WeightsChunk>* LearnerServiceImpl::GetWeights(grpc::CallbackServerContext* context,
                                                                           const v1::WeightsRequest* request) {
  auto* const stream = new WeightStream(this, context);
  stream->Start(*request);
  return stream;
}

}  // namespace craftfleet
