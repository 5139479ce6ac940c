// EnvServiceImpl: the requests of a session.
#include <algorithm>
#include <memory>
#include <utility>
#include <vector>

#include <absl/strings/escaping.h>
#include <absl/strings/str_format.h>

#include "common/base/printable.h"
#include "common/base/status_macros.h"
#include "common/config/env_name.h"
#include "common/process/version.h"
#include "common/wire/convert.h"
#include "common/wire/protocol.h"
#include "common/wire/request_check.h"
#include "envserver/env_service.h"
#include "envserver/world/snapshot.h"

namespace craftfleet {
namespace {

// Of a picture; twice its width takes 2 ms.
constexpr int kQuicklyDrawnBytes = 256 * 256 * 3;

int64_t FrameBytes(const RenderOptions& picture) { return int64_t{picture.width} * picture.height * 3; }

// The first format that the client asks for and that this server can send. Scene records only to a client that draws
// with the same textures: the handshake compares those that it names. Recordings need raw frames.
FrameFormat ChooseFormat(const v1::SessionHello& hello) {
  if (hello.has_recording()) return FrameFormat::kRaw;
  for (const int format : hello.frame_formats()) {
    if (format == v1::FRAMES_SCENE && !hello.texture_digest().empty()) return FrameFormat::kScene;
  }
  return FrameFormat::kRaw;
}

// At most the objects beyond the usual ones that `open` makes room for, before its snapshots are read.
int64_t MostObjects(const v1::OpenLanes& open) {
  int64_t objects = 0;
  for (const v1::OpenLanes::Lane& lane : open.lanes()) {
    const auto saved = static_cast<int64_t>(lane.snapshot().size() / kSavedObjectBytes);
    objects += std::max<int64_t>(2 * saved - kUsualObjects, 0);  // room doubles when there is none
  }
  return objects;
}

absl::Status CheckCount(int lanes) {
  if (lanes <= EnvBatch::kMaxLanes) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrFormat("%d lanes in one request, want at most %d", lanes, EnvBatch::kMaxLanes));
}

// Reports the lanes that were not opened, with reasons.
void AddRefused(const std::vector<EnvBatch::Refused>& refused, LimitedLog* log, v1::PlayReply* reply) {
  for (const EnvBatch::Refused& lane : refused) {
    v1::RefusedLane* message = reply->add_refused();
    message->set_lane(lane.lane);
    message->set_reason(Printable(lane.reason.substr(0, wire::kMaxReasonBytes)));
  }
  if (refused.empty()) return;
  log->Warn("lanes", absl::StrFormat("%d lanes refused; lane %d: %s", refused.size(), refused[0].lane,
                                     reply->refused(0).reason()));
}

}  // namespace

absl::Status EnvServiceImpl::Session::Reserve(int64_t more_games, int64_t more_objects) {
  const int64_t games = batch.size() + more_games;
  return share->Set(games, SessionBytes(games, batch.more_objects() + more_objects, batch.renderer().frame_bytes(),
                                        batch.records(), batch.picture_bytes()));
}

bool EnvServiceImpl::Session::slow() const {
  return std::max(batch.renderer().frame_bytes(), batch.picture_bytes()) > kQuicklyDrawnBytes;
}

absl::StatusOr<std::unique_ptr<EnvServiceImpl::Session>> EnvServiceImpl::Greet(const v1::SessionHello& hello,
                                                                               GameBudget::Share* share) {
  const wire::Handshake ours = {wire::kProtocolVersion, "", texture_digest_};
  const wire::Handshake theirs = {hello.protocol_version(), hello.run_id(), hello.texture_digest()};
  CRAFTFLEET_RETURN_IF_ERROR(wire::CheckHandshake("environment server", ours, "actor", theirs));
  if (!hello.game_canary().empty() && hello.game_canary() != canary_) {
    return absl::FailedPreconditionError(absl::StrFormat(
        "this environment server (build %s) plays another game than the run: its canary is not %s; run the same build "
        "everywhere",
        BuildId(), absl::CHexEscape(hello.game_canary().substr(0, 64))));
  }
  CRAFTFLEET_RETURN_IF_ERROR(wire::CheckText("client", hello.client()));
  CRAFTFLEET_RETURN_IF_ERROR(wire::CheckText("run_id", hello.run_id()));
  CRAFTFLEET_ASSIGN_OR_RETURN(const EnvName name, EnvName::Parse(hello.env().name()));
  WorldOptions world = WorldOptions::FromEnvName(name);
  if (hello.env().length() != 0) world.length = hello.env().length();
  CRAFTFLEET_RETURN_IF_ERROR(world.Validate());
  const RenderOptions picture{hello.env().frame_size(), hello.env().frame_size(), name.inventory};
  CRAFTFLEET_RETURN_IF_ERROR(picture.Validate(world));
  const int larger_size = hello.recording().picture_size();
  const RenderOptions larger_picture{larger_size, larger_size, name.inventory};
  const bool larger_wanted = larger_size != 0;
  if (larger_wanted) CRAFTFLEET_RETURN_IF_ERROR(larger_picture.Validate(world));
  // A renderer's tables are as large as some pictures.
  CRAFTFLEET_RETURN_IF_ERROR(share->Set(0, SessionBytes(0, 0, FrameBytes(picture), hello.has_recording(),
                                                        larger_wanted ? FrameBytes(larger_picture) : 0)));
  absl::StatusOr<std::shared_ptr<const Renderer>> renderer = Renderer::Create(*textures_, world, picture);
  // The textures lack a variant of this environment.
  if (absl::IsNotFound(renderer.status())) return absl::FailedPreconditionError(renderer.status().message());
  CRAFTFLEET_RETURN_IF_ERROR(renderer.status());
  EnvBatch batch(*std::move(renderer), ChooseFormat(hello));
  std::shared_ptr<const Renderer> larger;
  if (larger_wanted) {
    CRAFTFLEET_ASSIGN_OR_RETURN(larger, Renderer::Create(*textures_, world, larger_picture));
  }
  if (hello.has_recording()) batch.Record(std::move(larger));
  return std::make_unique<Session>(share, std::move(batch), &clock_);
}

absl::Status EnvServiceImpl::Begin(const v1::PlayRequest& request, Session* session, v1::PlayReply* reply) {
  switch (request.request_case()) {
    case v1::PlayRequest::kStep:
      CRAFTFLEET_RETURN_IF_ERROR(CheckCount(request.step().lanes_size()));
      CRAFTFLEET_RETURN_IF_ERROR(wire::ActionsFromProto(request.step(), &session->actions));
      return session->batch.Step(request.step().lanes(), session->actions, request.step().snapshot(), &session->step);
    case v1::PlayRequest::kOpen:
      session->to_open.clear();
      for (const v1::OpenLanes::Lane& lane : request.open().lanes()) {
        session->to_open.push_back(
            {lane.lane(), lane.seed(), lane.episode() == 0 ? 1 : lane.episode(), lane.snapshot()});
      }
      CRAFTFLEET_RETURN_IF_ERROR(
          session->Reserve(session->batch.CountClosed(session->to_open), MostObjects(request.open())));
      reply->Clear();
      return session->batch.Open(session->to_open, reply->mutable_frames());
    case v1::PlayRequest::kClose:
      CRAFTFLEET_RETURN_IF_ERROR(CheckCount(request.close().lanes_size()));
      session->batch.Close(request.close().lanes());
      return absl::OkStatus();
    case v1::PlayRequest::kHello:
      return absl::InvalidArgumentError("hello came twice");
    case v1::PlayRequest::REQUEST_NOT_SET:
      break;
  }
  return absl::InvalidArgumentError("an empty or unreadable request, want open, step or close");
}

absl::Status EnvServiceImpl::Complete(const v1::PlayRequest& request, Session* session, v1::PlayReply* reply) {
  EnvBatch& batch = session->batch;
  if (request.has_step()) {
    episodes_ += static_cast<int64_t>(session->step.episodes.size());
    reply->clear_refused();
    wire::ToProto(&session->step, reply);
    reply->clear_episode_steps();
    for (const int lane : request.step().lanes()) reply->add_episode_steps(batch.EpisodeSteps(lane));
    wire::ToProto(std::move(batch.moments()), reply);
    return session->Reserve(0, 0);  // objects appear in play
  }
  if (request.has_open()) {
    session->to_open = {};
    AddRefused(batch.refused(), &log_, reply);
    for (const v1::OpenLanes::Lane& lane : request.open().lanes()) {
      if (batch.IsOpen(lane.lane())) reply->add_episode_steps(batch.EpisodeSteps(lane.lane()));
    }
    wire::ToProto(std::move(batch.moments()), reply);
    if (!batch.refused().empty()) reply->mutable_frames()->shrink_to_fit();
  } else {  // what the closed games needed is counted no longer
    session->step = {};
    session->step.frames.shrink_to_fit();  // an assignment keeps its memory
    session->step.last_frames.shrink_to_fit();
    *reply = {};
  }
  return session->Reserve(0, 0);  // some of the lanes may have been open already, or refused
}

}  // namespace craftfleet
