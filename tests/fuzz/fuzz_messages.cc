// Messages between processes.

#include <cmath>

#include "common/base/check.h"
#include "common/io/paths.h"
#include "common/io/snapshot_envelope.h"
#include "common/wire/channel.h"
#include "common/wire/protocol.h"
#include "common/wire/server.h"
#include "common/wire/status_service.h"
#include "craftfleet/v1/environment.grpc.pb.h"
#include "craftfleet/v1/status.grpc.pb.h"
#include "envserver/env_service.h"
#include "learner/service/admin_service.h"
#include "learner/service/learner_service.h"
#include "tests/fakes/play_once.h"
#include "tests/fakes/wire_samples.h"
#include "tests/fuzz/fuzz_target.h"
#include "tests/learner/service/learner_parts.h"

namespace craftfleet {
namespace {

// Requests of actors to a learner. The first byte selects the call; after any input the registry must be consistent.
namespace learner_messages {

constexpr int64_t kEpoch = 1;
constexpr int64_t kVersion = 5;

struct Service : LearnerParts {
  explicit Service(Clock* clock) : LearnerParts(clock) {
    registry.Join("a", "");
    registry.OpenIteration(2, kVersion);
    weights.Publish(kVersion, std::make_shared<HostWeights>("weights"));
    registry.AddEvaluation({1, 4096, 1, 2, false, std::make_shared<HostWeights>("old weights")});
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

const FuzzTarget kTarget("learner_messages", TryInput, SoundInputs);

}  // namespace learner_messages

// The replies of a learner and an environment server to an actor. The first byte selects the message.
namespace learner_replies {

constexpr int kLanes = 3;
constexpr int kFrameBytes = 12;
constexpr int kPictureBytes = 27;
constexpr int kStateSize = 2;

void TryInput(absl::string_view input) {
  if (input.empty()) return;
  const absl::string_view bytes = input.substr(1);
  if (input[0] % 2 == 0) {
    v1::PlayReply reply;
    StepBatch batch;
    if (!reply.ParseFromArray(bytes.data(), static_cast<int>(bytes.size()))) return;
    const auto moments = wire::MomentsFromProto(&reply, kLanes, kFrameBytes, kPictureBytes);
    CRAFTFLEET_CHECK(!moments.ok() || moments->size() == kLanes);
    if (!wire::FromProto(&reply, kLanes, kFrameBytes, wire::kMaxEpisodeLength, &batch).ok()) return;
    CRAFTFLEET_CHECK(batch.rewards.size() == kLanes && batch.ends.size() == kLanes);
    CRAFTFLEET_CHECK(batch.frames.size() == kLanes * kFrameBytes && batch.last_frames.size() % kFrameBytes == 0);
  } else {
    v1::SnapshotReply reply;
    if (!reply.ParseFromArray(bytes.data(), static_cast<int>(bytes.size()))) return;
    const auto snapshot = wire::FromProto(&reply, kStateSize);
    CRAFTFLEET_CHECK(!snapshot.ok() || snapshot->state.size() == kStateSize);
  }
}

std::vector<std::string> SoundInputs() {
  StepBatch batch = SampleStepBatch();
  v1::PlayReply reply;
  wire::ToProto(&batch, &reply);
  wire::ToProto(std::vector<Moment>{SampleMoment(1), SampleMoment(2), SampleMoment(3)}, &reply);
  v1::SnapshotReply snapshot;
  snapshot.set_snapshot("a game");
  snapshot.add_state(0.5F);
  snapshot.add_state(-1);
  return {'\0' + reply.SerializeAsString(), '\1' + snapshot.SerializeAsString()};
}

const FuzzTarget kTarget("learner_replies", TryInput, SoundInputs);

}  // namespace learner_replies

// Other requests to a learner: weights, its status, draining a worker. The first byte selects the call,
// which goes over real gRPC in process.
namespace watch_and_steer {

constexpr int64_t kVersion = 5;
constexpr char kWeights[] = "weights";

// A learner without training, shared by all inputs.
struct Learner : LearnerParts {
  explicit Learner(Clock* clock) : LearnerParts(clock) {
    registry.Join("a", "");
    weights.Publish(kVersion, std::make_shared<HostWeights>(kWeights));
    registry.AddEvaluation({1, 4096, 1, 2, false, std::make_shared<HostWeights>("old weights")});
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
  if (!Parse(bytes, &request)) return;
  grpc::ClientContext context;
  const auto stream = v1::LearnerService::NewStub(TheLearner()->channel)->GetWeights(&context, request);
  v1::WeightsChunk chunk;
  std::string weights;
  while (stream->Read(&chunk)) weights += chunk.data();
  const bool ok = stream->Finish().ok();
  CRAFTFLEET_CHECK(!ok || weights == (request.evaluation() == 0 ? kWeights : "old weights"));
}

void GetStatus(absl::string_view bytes) {
  v1::StatusRequest request;
  if (!Parse(bytes, &request)) return;
  grpc::ClientContext context;
  v1::StatusReply reply;
  CRAFTFLEET_CHECK(v1::StatusService::NewStub(TheLearner()->channel)->GetStatus(&context, request, &reply).ok());
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

void TryInput(absl::string_view input) {
  if (input.empty()) return;
  const absl::string_view bytes = input.substr(1);
  switch (input[0] % 3) {
    case 0:
      return Download(bytes);
    case 1:
      return GetStatus(bytes);
    default:
      return Drain(bytes);
  }
}

std::vector<std::string> SoundInputs() {
  v1::WeightsRequest weights;
  weights.set_at_least(kVersion);
  v1::WeightsRequest of_evaluation;
  of_evaluation.set_evaluation(1);
  v1::DrainRequest drain;
  drain.set_worker("a");
  return {'\0' + weights.SerializeAsString(), '\0' + of_evaluation.SerializeAsString(),
          '\1' + v1::StatusRequest().SerializeAsString(), '\2' + drain.SerializeAsString()};
}

const FuzzTarget kTarget("watch_and_steer", TryInput, SoundInputs);

}  // namespace watch_and_steer

// The requests of one session with an environment server, each after two bytes with its length.
namespace env_session {

constexpr int kMaxRequests = 8;

// One service for all inputs: a session that fails must not affect the next.
v1::EnvironmentService::Stub* Stub() {
  static EnvServiceImpl* service = EnvServiceImpl::Create(DefaultTextureDir().value()).value().release();
  static wire::Server* server = wire::Server::Create({}, {service}).value().release();
  static v1::EnvironmentService::Stub* stub = v1::EnvironmentService::NewStub(server->InProcess().channel).release();
  return stub;
}

std::vector<v1::PlayRequest> Requests(absl::string_view input) {
  std::vector<v1::PlayRequest> requests;
  while (input.size() >= 2 && requests.size() < kMaxRequests) {
    const size_t length = static_cast<uint8_t>(input[0]) + 256 * static_cast<uint8_t>(input[1]);
    const absl::string_view bytes = input.substr(2, length);
    input.remove_prefix(2 + bytes.size());
    v1::PlayRequest request;
    if (request.ParseFromArray(bytes.data(), static_cast<int>(bytes.size()))) requests.push_back(std::move(request));
  }
  return requests;
}

std::string Session(const std::vector<v1::PlayRequest>& requests) {
  std::string input;
  for (const v1::PlayRequest& request : requests) {
    const std::string bytes = request.SerializeAsString();
    input.push_back(static_cast<char>(bytes.size() % 256));
    input.push_back(static_cast<char>(bytes.size() / 256));
    input += bytes;
  }
  return input;
}

v1::PlayRequest Hello() {
  v1::PlayRequest request;
  v1::SessionHello* hello = request.mutable_hello();
  hello->set_protocol_version(wire::kProtocolVersion);
  hello->mutable_env()->set_name("crafter");
  hello->mutable_env()->set_frame_size(27);
  return request;
}

v1::PlayRequest Open() {
  v1::PlayRequest request;
  v1::OpenLanes::Lane* lane = request.mutable_open()->add_lanes();
  lane->set_lane(3);
  lane->set_seed(7);
  return request;
}

// Opens a lane with a snapshot in a valid envelope that is not a game.
v1::PlayRequest OpenFrom(const std::string& game) {
  v1::PlayRequest request = Open();
  request.mutable_open()->mutable_lanes(0)->set_snapshot(SealSnapshot(EnvDigest("crafter", kEpisodeLength), game));
  return request;
}

v1::PlayRequest Step() {
  v1::PlayRequest request;
  request.mutable_step()->add_lanes(3);
  request.mutable_step()->set_actions(std::string(1, '\5'));
  request.mutable_step()->set_snapshot(true);
  return request;
}

void TryInput(absl::string_view input) {
  grpc::ClientContext context;
  const auto stream = Stub()->Play(&context);
  v1::PlayReply reply;
  for (const v1::PlayRequest& request : Requests(input)) {
    // Pictures of a million pixels are allowed, but too slow for this search.
    if (request.hello().env().frame_size() > 64 || request.hello().recording().picture_size() > 64) break;
    if (!stream->Write(request) || !stream->Read(&reply)) break;
  }
  stream->WritesDone();
  const grpc::StatusCode code = stream->Finish().error_code();
  CRAFTFLEET_CHECK(code == grpc::StatusCode::OK || code == grpc::StatusCode::INVALID_ARGUMENT ||
                   code == grpc::StatusCode::FAILED_PRECONDITION || code == grpc::StatusCode::DATA_LOSS);
}

std::vector<std::string> SoundInputs() {
  v1::PlayRequest close;
  close.mutable_close()->add_lanes(3);
  v1::PlayRequest recording = Hello();
  recording.mutable_hello()->mutable_recording()->set_picture_size(36);
  return {Session({Hello(), Open(), Step(), Step(), close}), Session({Hello()}), Session({Hello(), Open(), Step()}),
          Session({Hello(), OpenFrom("CFWORLD"), Open(), Step()}), Session({recording, Open(), Step()})};
}

const FuzzTarget kTarget("env_session", TryInput, SoundInputs);

}  // namespace env_session

}  // namespace
}  // namespace craftfleet
