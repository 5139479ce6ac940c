// The requests of one session with an environment server, each after two bytes with its length.

#include "common/base/check.h"
#include "common/io/paths.h"
#include "common/io/snapshot_envelope.h"
#include "common/wire/protocol.h"
#include "common/wire/server.h"
#include "craftfleet/v1/environment.grpc.pb.h"
#include "envserver/env_service.h"
#include "tests/fuzz/fuzz_target.h"

namespace craftfleet {
namespace {

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

}  // namespace

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

}  // namespace craftfleet
