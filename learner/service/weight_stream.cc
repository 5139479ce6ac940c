// LearnerServiceImpl: downloads of weights.
#include <memory>
#include <optional>
#include <utility>

#include <absl/strings/str_format.h>

#include "common/wire/grpc_status.h"
#include "learner/service/learner_service.h"

namespace craftfleet {
namespace {

// Each download that waits for its client holds two chunks, and there may be thousands of downloads.
constexpr size_t kChunkBytes = 128u << 10;

}  // namespace

// One call of GetWeights: waits for the weights, then writes one chunk after the other. gRPC calls one method at a
// time, and OnDone last.
class LearnerServiceImpl::WeightStream final : public grpc::ServerWriteReactor<v1::WeightsChunk> {
 public:
  WeightStream(LearnerServiceImpl* service, grpc::CallbackServerContext* context)
      : service_(service), watched_(std::in_place, &service->streams_, context) {}

  void Start(const v1::WeightsRequest& request) {
    if (!watched_->admitted().ok()) return End(watched_->admitted());
    service_->waiting_for_weights_.Add([this, request](bool last) { return Find(request, last); },
                                       WaitTime(request.wait_ms()));
  }

  void OnWriteDone(bool ok) override {
    if (!ok) return End(watched_->late());
    WriteNext();
  }

  void OnDone() override { delete this; }

 private:
  // Frees the stream's place before the client learns that it has ended.
  void End(absl::Status status) {
    watched_.reset();
    Finish(wire::ToGrpc(status));
  }

  // Returns false if the weights are not available yet and this is not the `last` attempt.
  bool Find(const v1::WeightsRequest& request, bool last) {
    const absl::StatusOr<WeightStore::Weights> weights = service_->FindWeights(request);
    if (weights.status().code() == absl::StatusCode::kDeadlineExceeded && !last) return false;
    if (weights.ok()) {
      bytes_ = weights->bytes;
      chunk_.set_policy_version(weights->version);
      chunk_.set_total_bytes(static_cast<int64_t>(bytes_->size()));
      WriteNext();
    } else {
      End(weights.status());
    }
    return true;
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

absl::StatusOr<WeightStore::Weights> LearnerServiceImpl::FindWeights(const v1::WeightsRequest& request) const {
  if (request.evaluation() != 0) {
    std::shared_ptr<const std::string> bytes = registry_->evaluations()->Weights(request.evaluation());
    if (bytes == nullptr) {
      return absl::AbortedError(absl::StrFormat("evaluation task %d is over", request.evaluation()));
    }
    return WeightStore::Weights{0, std::move(bytes), {}};
  }
  WeightStore::Weights weights = weights_->Find(request.at_least());
  if (weights.bytes == nullptr || weights.version < request.at_least()) {
    return absl::DeadlineExceededError(absl::StrFormat("policy version %d is not available yet, the latest is %d",
                                                       request.at_least(), weights.version));
  }
  return weights;
}

}  // namespace craftfleet
