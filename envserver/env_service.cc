#include "envserver/env_service.h"

#include <utility>
#include <vector>

#include <absl/strings/str_format.h>
#include <absl/time/clock.h>

#include "common/env_name.h"
#include "common/log.h"
#include "common/status_macros.h"
#include "common/texture_digest.h"
#include "common/version.h"
#include "common/wire/convert.h"
#include "common/wire/grpc_status.h"
#include "common/wire/protocol.h"
#include "common/wire/status_service.h"

namespace craftfleet {

// Counts a session from Enter on, as long as it lives.
class EnvServiceImpl::SessionGuard {
 public:
  explicit SessionGuard(EnvServiceImpl* service) : service_(service) {}
  ~SessionGuard() {
    MutexLock lock(&service_->mu_);
    service_->sessions_.erase(this);
    service_->changed_.NotifyAll();
  }
  // Takes the server for the session's run.   FailedPrecondition: it has sessions of another.
  absl::Status Enter(const v1::SessionHello& hello, const std::string& address) {
    MutexLock lock(&service_->mu_);
    std::string& run_id = service_->run_id_;
    if (service_->sessions_.empty() || run_id.empty()) run_id = hello.run_id();
    CRAFTFLEET_RETURN_IF_ERROR(wire::CheckHandshake("environment server", {wire::kProtocolVersion, run_id, ""}, "actor",
                                                    {wire::kProtocolVersion, hello.run_id(), ""}));
    service_->sessions_[this] = {hello.client(), address, 0};
    return absl::OkStatus();
  }
  void SetLanes(int lanes) {
    MutexLock lock(&service_->mu_);
    service_->sessions_[this].lanes = lanes;
    service_->changed_.NotifyAll();
  }

 private:
  EnvServiceImpl* const service_;
};

absl::StatusOr<std::unique_ptr<EnvServiceImpl>> EnvServiceImpl::Create(const std::string& texture_dir) {
  CRAFTFLEET_ASSIGN_OR_RETURN(std::shared_ptr<const Textures> textures, Textures::Load(texture_dir));
  CRAFTFLEET_ASSIGN_OR_RETURN(std::string digest, TextureDigest(texture_dir));
  return std::unique_ptr<EnvServiceImpl>(new EnvServiceImpl(std::move(textures), std::move(digest)));
}

EnvServiceImpl::EnvServiceImpl(std::shared_ptr<const Textures> textures, std::string texture_digest)
    : textures_(std::move(textures)), texture_digest_(std::move(texture_digest)) {}

grpc::Status EnvServiceImpl::Play(grpc::ServerContext* context,
                                  grpc::ServerReaderWriter<v1::PlayReply, v1::PlayRequest>* stream) {
  const absl::Status status = Serve(context->peer(), stream);
  if (!status.ok()) {
    ++rejected_;
    LogWarning("session of %s ended: %s", context->peer(), status.message());
  }
  return wire::ToGrpc(status);
}

absl::Status EnvServiceImpl::Serve(const std::string& peer,
                                   grpc::ServerReaderWriter<v1::PlayReply, v1::PlayRequest>* stream) {
  v1::PlayRequest request;
  v1::PlayReply reply;
  if (!stream->Read(&request)) return absl::OkStatus();
  if (!request.has_hello()) return absl::InvalidArgumentError("a session begins with hello");
  CRAFTFLEET_ASSIGN_OR_RETURN(EnvBatch batch, Greet(request.hello()));
  SessionGuard session(this);
  CRAFTFLEET_RETURN_IF_ERROR(session.Enter(request.hello(), peer));
  reply.set_program_version(std::string(ProgramVersion()));
  StepBatch step;
  while (stream->Write(reply) && stream->Read(&request)) {
    reply.clear_program_version();
    CRAFTFLEET_RETURN_IF_ERROR(Handle(request, &batch, &step, &reply));
    if (!request.has_step()) session.SetLanes(batch.size());
  }
  return absl::OkStatus();
}

absl::StatusOr<EnvBatch> EnvServiceImpl::Greet(const v1::SessionHello& hello) const {
  const wire::Handshake ours = {wire::kProtocolVersion, "", texture_digest_};
  const wire::Handshake theirs = {hello.protocol_version(), hello.run_id(), hello.texture_digest()};
  CRAFTFLEET_RETURN_IF_ERROR(wire::CheckHandshake("environment server", ours, "actor", theirs));
  CRAFTFLEET_ASSIGN_OR_RETURN(const EnvName name, EnvName::Parse(hello.env().name()));
  WorldOptions world = WorldOptions::FromEnvName(name);
  if (hello.env().length() != 0) world.length = hello.env().length();
  CRAFTFLEET_RETURN_IF_ERROR(world.Validate());
  RenderOptions picture;
  picture.width = hello.env().frame_size();
  picture.height = hello.env().frame_size();
  picture.inventory = name.inventory;
  CRAFTFLEET_ASSIGN_OR_RETURN(std::shared_ptr<const Renderer> renderer, Renderer::Create(*textures_, world, picture));
  if (!hello.has_recording()) return EnvBatch(std::move(renderer));
  std::shared_ptr<const Renderer> larger;
  if (hello.recording().picture_size() != 0) {
    picture.width = hello.recording().picture_size();
    picture.height = hello.recording().picture_size();
    CRAFTFLEET_ASSIGN_OR_RETURN(larger, Renderer::Create(*textures_, world, picture));
  }
  return EnvBatch(std::move(renderer), MomentTaker(std::move(larger)));
}

absl::Status EnvServiceImpl::Handle(const v1::PlayRequest& request, EnvBatch* batch, StepBatch* step,
                                    v1::PlayReply* reply) {
  switch (request.request_case()) {
    case v1::PlayRequest::kStep: {
      std::vector<Action> actions;
      CRAFTFLEET_RETURN_IF_ERROR(wire::ActionsFromProto(request.step(), &actions));
      const int64_t start = absl::GetCurrentTimeNanos();
      CRAFTFLEET_RETURN_IF_ERROR(batch->Step(request.step().lanes(), actions, request.step().snapshot(), step));
      step_ns_ += absl::GetCurrentTimeNanos() - start;
      steps_ += static_cast<int64_t>(actions.size());
      rate_.Add(static_cast<int64_t>(actions.size()));
      episodes_ += static_cast<int64_t>(step->episodes.size());
      wire::ToProto(step, reply);
      wire::ToProto(std::move(batch->moments()), reply);
      return absl::OkStatus();
    }
    case v1::PlayRequest::kOpen: {
      std::vector<EnvBatch::OpenLane> lanes;
      for (const v1::OpenLanes::Lane& lane : request.open().lanes()) {
        lanes.push_back({lane.lane(), lane.seed(), lane.episode() == 0 ? 1 : lane.episode(), lane.snapshot()});
      }
      reply->Clear();
      CRAFTFLEET_RETURN_IF_ERROR(batch->Open(lanes, reply->mutable_frames()));
      wire::ToProto(std::move(batch->moments()), reply);
      return absl::OkStatus();
    }
    case v1::PlayRequest::kClose:
      reply->Clear();
      batch->Close(request.close().lanes());
      return absl::OkStatus();
    case v1::PlayRequest::kHello:
      return absl::InvalidArgumentError("hello came twice");
    case v1::PlayRequest::REQUEST_NOT_SET:
      break;
  }
  return absl::InvalidArgumentError("an empty request, want open, step or close");
}

void EnvServiceImpl::WaitUntilEmpty(absl::Duration timeout) {
  const MutexLock lock(&mu_);
  changed_.WaitFor(&mu_, timeout, [this]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) {
    for (const auto& [key, session] : sessions_) {
      if (session.lanes > 0) return false;
    }
    return true;
  });
}

void EnvServiceImpl::FillStatus(v1::StatusReply* reply) const {
  MutexLock lock(&mu_);
  reply->set_run_id(run_id_);
  int lanes = 0;
  for (const auto& [key, session] : sessions_) {
    lanes += session.lanes;
    v1::Peer* peer = reply->add_peers();
    peer->set_name(session.client);
    peer->set_role("actor");
    peer->set_address(session.address);
    peer->set_state(absl::StrFormat("%d lanes", session.lanes));
  }
  wire::AddMetric("sessions", static_cast<double>(sessions_.size()), "", reply);
  wire::AddMetric("sessions_rejected", static_cast<double>(rejected_.load()), "", reply);
  wire::AddMetric("lanes", lanes, "lanes", reply);
  wire::AddMetric("env_steps", static_cast<double>(steps_.load()), "steps", reply);
  wire::AddMetric("steps_per_second", rate_.PerSecond(), "steps/s", reply);
  wire::AddMetric("episodes", static_cast<double>(episodes_.load()), "episodes", reply);
  wire::AddMetric("step_time", step_seconds(), "s", reply);
}

}  // namespace craftfleet
