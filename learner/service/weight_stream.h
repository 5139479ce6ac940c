// A download of weights.

#pragma once

#include <cstddef>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include <absl/status/status.h>
#include <grpcpp/grpcpp.h>

#include "common/wire/stream_watch.h"
#include "craftfleet/v1/learner.pb.h"
#include "learner/service/learner_service.h"
#include "learner/training/weight_store.h"

namespace craftfleet {

// One call of GetWeights: waits for the weights, then writes one chunk after the other. gRPC calls one method at a
// time, and OnDone last.
class WeightStream final : public grpc::ServerWriteReactor<v1::WeightsChunk> {
 public:
  WeightStream(LearnerServiceImpl* service, grpc::CallbackServerContext* context)
      : service_(service), watched_(std::in_place, &service->streams_, context) {}

  void Start(const v1::WeightsRequest& request);

  void OnWriteDone(bool ok) override;
  void OnDone() override { delete this; }

 private:
  // Frees the stream's place before the client learns that it has ended.
  void End(absl::Status status);
  // Returns false if the weights are not available yet and this is not the `last` attempt.
  bool Find(const v1::WeightsRequest& request, bool last);
  // Prepares to write the weights. Errors as PolicyWeights::Bytes.
  absl::Status Take(const WeightStore::Weights& found);
  void WriteNext();

  LearnerServiceImpl* const service_;
  std::optional<wire::StreamWatch::Stream> watched_;  // until the call ends
  std::shared_ptr<const std::string> bytes_;
  size_t sent_ = 0;
  v1::WeightsChunk chunk_;
};

}  // namespace craftfleet
