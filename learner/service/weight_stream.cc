#include "learner/service/weight_stream.h"

#include "common/wire/grpc_status.h"

namespace craftfleet {
namespace {

// Each download that waits for its client holds two chunks, and there may be thousands of downloads.
constexpr size_t kChunkBytes = 128u << 10;

}  // namespace

void WeightStream::Start(const v1::WeightsRequest& request) {
  if (!watched_->admitted().ok()) return End(watched_->admitted());
  service_->waiting_for_weights_.Add([this, request](bool last) { return Find(request, last); },
                                     LearnerServiceImpl::WaitTime(request.wait_ms()));
}

void WeightStream::OnWriteDone(bool ok) {
  if (!ok) return End(watched_->late());
  WriteNext();
}

void WeightStream::End(absl::Status status) {
  watched_.reset();
  Finish(wire::ToGrpc(status));
}

bool WeightStream::Find(const v1::WeightsRequest& request, bool last) {
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

void WeightStream::WriteNext() {
  if (sent_ >= bytes_->size()) return End(watched_->late());
  chunk_.mutable_data()->assign(*bytes_, sent_, kChunkBytes);
  sent_ += kChunkBytes;
  watched_->Await("weights to be taken", service_->options_.reply_timeout);
  StartWrite(&chunk_);
}

}  // namespace craftfleet
