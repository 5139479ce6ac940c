// Other requests to a learner: weights, a stream of its status, draining a worker. The first byte selects the call,
// which goes over real gRPC in process.

#include "common/base/check.h"
#include "common/wire/channel.h"
#include "common/wire/server.h"
#include "common/wire/status_service.h"
#include "craftfleet/v1/status.grpc.pb.h"
#include "learner/service/admin_service.h"
#include "learner/service/learner_service.h"
#include "tests/fakes/wire_samples.h"
#include "tests/fuzz/fuzz_target.h"
#include "tests/learner/service/learner_parts.h"

namespace craftfleet {
namespace {

constexpr int64_t kVersion = 5;
constexpr char kWeights[] = "weights";

// A learner without training, shared by all inputs.
struct Learner : LearnerParts {
  explicit Learner(Clock* clock) : LearnerParts(clock) {
    registry.Join("a", "");
    weights.Publish(kVersion, std::make_shared<std::string>(kWeights));
    registry.AddEvaluation({1, 4096, 1, 2, false, std::make_shared<std::string>("old weights")});
  }

  CheckpointRequests checkpoints;
  LearnerServiceImpl service{{}, &registry, &weights, &fragments};
  Steering steering{{&checkpoints, &registry, [] {}}};
  AdminServiceImpl admin{&steering};
  wire::StatusServiceImpl status{"learner", [this](v1::StatusReply* reply) { service.FillStatus(reply); }};
  std::unique_ptr<wire::Server> server = wire::Server::Create({}, {&service, &admin, &status}).value();
  std::shared_ptr<grpc::Channel> channel = server->InProcess().channel;
};

Learner* TheLearner() {
  static auto* learner = new Learner(new RealClock);
  return learner;
}

template <typename Request>
bool Parse(absl::string_view bytes, Request* request) {
  return request->ParseFromArray(bytes.data(), static_cast<int>(bytes.size()));
}

void Download(absl::string_view bytes) {
  v1::WeightsRequest request;
  if (!Parse(bytes, &request) || request.wait_ms() > 1) return;  // a longer wait only slows the search
  grpc::ClientContext context;
  const auto stream = v1::LearnerService::NewStub(TheLearner()->channel)->GetWeights(&context, request);
  v1::WeightsChunk chunk;
  std::string weights;
  while (stream->Read(&chunk)) weights += chunk.data();
  const bool ok = stream->Finish().ok();
  CRAFTFLEET_CHECK(!ok || weights == (request.evaluation() == 0 ? kWeights : "old weights"));
}

void Watch(absl::string_view bytes) {
  v1::WatchRequest request;
  if (!Parse(bytes, &request)) return;
  grpc::ClientContext context;
  const auto stream = v1::StatusService::NewStub(TheLearner()->channel)->WatchStatus(&context, request);
  v1::StatusReply reply;
  if (stream->Read(&reply)) context.TryCancel();
  CRAFTFLEET_CHECK(!stream->Finish().ok());  // cancelled, or refused
}

// The only worker holds no permits, so it is drained at once.
void Drain(absl::string_view bytes) {
  v1::DrainRequest request;
  if (!Parse(bytes, &request)) return;
  TheLearner()->registry.Join("a", "");
  grpc::ClientContext context;
  wire::SetDeadline(&context, absl::Seconds(10));
  v1::DrainReply reply;
  const grpc::Status status = v1::AdminService::NewStub(TheLearner()->channel)->Drain(&context, request, &reply);
  CRAFTFLEET_CHECK(status.ok() == (request.worker() == "a"));
}

}  // namespace

void TryInput(absl::string_view input) {
  if (input.empty()) return;
  const absl::string_view bytes = input.substr(1);
  switch (input[0] % 3) {
    case 0:
      return Download(bytes);
    case 1:
      return Watch(bytes);
    default:
      return Drain(bytes);
  }
}

std::vector<std::string> SoundInputs() {
  v1::WeightsRequest weights;
  weights.set_at_least(kVersion);
  v1::WeightsRequest of_evaluation;
  of_evaluation.set_evaluation(1);
  v1::WatchRequest watch;
  watch.set_interval_ms(100);
  v1::DrainRequest drain;
  drain.set_worker("a");
  return {'\0' + weights.SerializeAsString(), '\0' + of_evaluation.SerializeAsString(),
          '\1' + watch.SerializeAsString(), '\2' + drain.SerializeAsString()};
}

}  // namespace craftfleet
