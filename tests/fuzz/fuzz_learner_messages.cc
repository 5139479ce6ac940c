// Requests of actors to a learner. The first byte selects the call; after any input the registry must be consistent.

#include <cmath>

#include "common/base/check.h"
#include "common/io/snapshot_envelope.h"
#include "common/wire/protocol.h"
#include "common/wire/server.h"
#include "learner/service/learner_service.h"
#include "tests/fakes/play_once.h"
#include "tests/fakes/wire_samples.h"
#include "tests/fuzz/fuzz_target.h"
#include "tests/learner/service/learner_parts.h"

namespace craftfleet {
namespace {

constexpr int64_t kEpoch = 1;
constexpr int64_t kVersion = 5;

struct Service : LearnerParts {
  explicit Service(Clock* clock) : LearnerParts(clock) {
    registry.Join("a", "");
    registry.OpenIteration(2, kVersion);
    weights.Publish(kVersion, std::make_shared<std::string>("weights"));
    registry.AddEvaluation({1, 4096, 1, 2, false, std::make_shared<std::string>("old weights")});
  }

  LearnerServiceImpl service{SampleServiceOptions(kEpoch, absl::Seconds(5)), &registry, &weights, &fragments};
};

template <typename Request, typename Reply>
void Call(LearnerServiceImpl* service,
          grpc::ServerUnaryReactor* (LearnerServiceImpl::*method)(grpc::CallbackServerContext*, const Request*, Reply*),
          absl::string_view bytes) {
  Request request;
  Reply reply;
  if (!request.ParseFromArray(bytes.data(), static_cast<int>(bytes.size()))) return;
  grpc::CallbackServerContext context;
  (service->*method)(&context, &request, &reply);
}

// Over real gRPC in process, as a stream needs.
void Ask(Service* service, absl::string_view bytes) {
  v1::PermitRequest request;
  if (!request.ParseFromArray(bytes.data(), static_cast<int>(bytes.size()))) return;
  request.set_wait_ms(0);
  const auto server = wire::Server::Create({}, {&service->service}).value();
  const auto stub = v1::LearnerService::NewStub(server->InProcess().channel);
  AskOnce(stub.get(), request).status().IgnoreError();
}

// An accepted fragment must have the run's shape.
void Push(Service* service, absl::string_view bytes) {
  v1::FragmentMessage message;
  if (!message.ParseFromArray(bytes.data(), static_cast<int>(bytes.size()))) return;
  const std::string actor = message.actor();
  const auto fragment = wire::FromProto(&message, kSampleShape);
  if (!fragment.ok()) return;
  CRAFTFLEET_CHECK(fragment->lane >= 0 && fragment->lane < kSampleShape.lanes);
  CRAFTFLEET_CHECK(static_cast<int>(fragment->actions.size()) == kSampleShape.steps);
  CRAFTFLEET_CHECK(static_cast<int>(fragment->frames.size()) == kSampleShape.steps * kSampleShape.frame_bytes);
  for (const float log_prob : fragment->log_probs) CRAFTFLEET_CHECK(log_prob >= wire::kMinLogProb && log_prob <= 0);
  for (const float value : fragment->values) CRAFTFLEET_CHECK(std::abs(value) <= wire::kMaxValue);
  for (const Episode& episode : fragment->episodes) CRAFTFLEET_CHECK(episode.length <= kSampleShape.max_length);
  CRAFTFLEET_CHECK(OpenSnapshot(kSampleShape.env_digest, fragment->snapshot.game).ok());
  service->registry.Accept(actor, {fragment->lane, fragment->number, fragment->policy_version}, fragment->snapshot)
      .status()
      .IgnoreError();
}

template <typename Message>
std::string Input(char call, const Message& message) {
  return call + message.SerializeAsString();
}

}  // namespace

void TryInput(absl::string_view input) {
  if (input.empty()) return;
  RealClock clock;
  Service service(&clock);
  const absl::string_view bytes = input.substr(1);
  switch (input[0] % 7) {
    case 0:
      Call(&service.service, &LearnerServiceImpl::Join, bytes);
      break;
    case 1:
      Ask(&service, bytes);
      break;
    case 2:
      Push(&service, bytes);
      break;
    case 3:
      Call(&service.service, &LearnerServiceImpl::GetSnapshot, bytes);
      break;
    case 4:
      Call(&service.service, &LearnerServiceImpl::FinishEvaluation, bytes);
      break;
    case 5:
      Call(&service.service, &LearnerServiceImpl::Leave, bytes);
      break;
    default:
      Call(&service.service, &LearnerServiceImpl::Announce, bytes);
  }
  const std::vector<LaneRecord> lanes = service.registry.Records();
  CRAFTFLEET_CHECK(static_cast<int>(lanes.size()) == kSampleShape.lanes);
  for (const LaneRecord& lane : lanes) CRAFTFLEET_CHECK(lane.next_fragment >= 0 && lane.next_fragment <= 2);
  CRAFTFLEET_CHECK(service.registry.pending_evaluations() == 1);
  v1::StatusReply status;
  service.service.FillStatus(&status);
}

std::vector<std::string> SoundInputs() {
  v1::JoinRequest join;
  join.set_protocol_version(wire::kProtocolVersion);
  join.set_actor("b");
  v1::PermitRequest permits;
  permits.set_actor("a");
  permits.set_epoch(kEpoch);
  permits.set_capacity(4);
  permits.set_evaluates(true);
  permits.set_wants_env_servers(true);
  v1::Permit* permit = permits.add_active();
  permit->set_policy_version(kVersion);
  v1::LaneFailure* failure = permits.add_failures();
  failure->set_lane(1);
  failure->set_reason("not a world's");
  permits.mutable_summary()->add_times()->set_share(0.5);
  v1::FragmentMessage fragment = wire::ToProto(SampleFragment(1, 0, kVersion));
  fragment.set_actor("a");
  v1::SnapshotRequest snapshot;
  snapshot.set_epoch(kEpoch);
  snapshot.set_lane(1);
  v1::EvaluationResult result = wire::ToProto({EndedEpisode(0, 9), EndedEpisode(0, 12)});
  result.set_epoch(kEpoch);
  result.set_id(2);
  v1::LeaveRequest leave;
  leave.set_actor("a");
  v1::Announcement announcement;
  announcement.set_protocol_version(wire::kProtocolVersion);
  announcement.set_name("s");
  announcement.set_address("10.0.0.1:50061");
  return {Input('\0', join),   Input('\1', permits), Input('\2', fragment),    Input('\3', snapshot),
          Input('\4', result), Input('\5', leave),   Input('\6', announcement)};
}

}  // namespace craftfleet
