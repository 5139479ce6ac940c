#include "learner/service/weight_stream.h"

#include "common/base/status_macros.h"
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
  const absl::StatusOr<WeightStore::Weights> found = service_->FindWeights(request);
  if (found.status().code() == absl::StatusCode::kDeadlineExceeded && !last) return false;
  const absl::Status status = found.ok() ? Take(*found) : found.status();
  status.ok() ? WriteNext() : End(status);
  return true;
}

absl::Status WeightStream::Take(const WeightStore::Weights& found) {
  CRAFTFLEET_ASSIGN_OR_RETURN(bytes_, found.weights->Bytes());
  chunk_.set_policy_version(found.version);
  chunk_.set_total_bytes(static_cast<int64_t>(bytes_->size()));
  return absl::OkStatus();
}

void WeightStream::WriteNext() {
  if (sent_ >= bytes_->size()) return End(watched_->late());
  chunk_.mutable_data()->assign(*bytes_, sent_, kChunkBytes);
  sent_ += kChunkBytes;
  watched_->Await("weights to be taken", service_->options_.reply_timeout);
  StartWrite(&chunk_);
}

}  // namespace craftfleet
