#include "envserver/env_service.h"

#include <exception>
#include <limits>
#include <optional>
#include <utility>
#include <vector>

#include <absl/strings/escaping.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>

#include "common/base/clock.h"
#include "common/base/printable.h"
#include "common/base/status_macros.h"
#include "common/config/env_name.h"
#include "common/io/texture_digest.h"
#include "common/process/version.h"
#include "common/wire/convert.h"
#include "common/wire/grpc_status.h"
#include "common/wire/packed_frames.h"
#include "common/wire/protocol.h"
#include "common/wire/request_check.h"
#include "common/wire/status_service.h"
#include "envserver/canary.h"
#include "envserver/render/built_in_textures.h"

namespace craftfleet {
namespace {

constexpr absl::Duration kSummarizeEvery = absl::Seconds(1);

int64_t FrameBytes(const RenderOptions& picture) { return int64_t{picture.width} * picture.height * 3; }

// Reserves memory for `games` like those of `batch`, or releases it.
absl::Status SetGames(int64_t games, const EnvBatch& batch, GameBudget::Share* share) {
  return share->Set(games, SessionBytes(games, batch.renderer().frame_bytes(), batch.records(), batch.picture_bytes()));
}

// The first format that the client asks for and that this server can send. Scene records only to a client that draws
// with the same textures: the handshake compares those that it names.
FrameFormat ChooseFormat(const v1::SessionHello& hello) {
  for (const int format : hello.frame_formats()) {
    if (format == v1::FRAMES_SCENE && !hello.texture_digest().empty()) return FrameFormat::kScene;
    if (format == v1::FRAMES_LZ4) return FrameFormat::kLz4;
  }
  return FrameFormat::kRaw;
}

// Gives a reply's raw frames the session's format.
void Pack(FrameFormat format, v1::PlayReply* reply) {
  if (format != FrameFormat::kLz4) return;
  wire::PackFrames(reply->mutable_frames());
  wire::PackFrames(reply->mutable_last_frames());
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

// Registers a session from Enter() until destruction.
class EnvServiceImpl::SessionGuard {
 public:
  explicit SessionGuard(EnvServiceImpl* service)
      : service_(service), meter_(&service->clock_, Activity::kEnvironment) {}
  ~SessionGuard() {
    MutexLock lock(&service_->mu_);
    if (service_->sessions_.erase(this) > 0) service_->ended_.Add(meter_.Total());
    service_->changed_.NotifyAll();
  }
  // Binds the server to the session's run.   FailedPrecondition: it belongs to another run (SetRun).
  // ResourceExhausted: it has sessions of another run.
  absl::Status Enter(const v1::SessionHello& hello, grpc::ServerContext* context) {
    MutexLock lock(&service_->mu_);
    std::string& run_id = service_->run_id_;
    const std::string last_run_id = run_id;
    if (!service_->own_run_id_.empty()) {
      run_id = service_->own_run_id_;
    } else if (service_->sessions_.empty() || run_id.empty()) {
      run_id = hello.run_id();
    }
    if (run_id != last_run_id && !run_id.empty()) service_->log_.Info("run", absl::StrCat("serves run ", run_id));
    const absl::Status same_run = wire::CheckHandshake("environment server", {wire::kProtocolVersion, run_id, ""},
                                                       "actor", {wire::kProtocolVersion, hello.run_id(), ""});
    // Without a learner it is free again when the other run's sessions end: actors wait, as any client may claim it.
    if (!same_run.ok() && service_->own_run_id_.empty()) return absl::ResourceExhaustedError(same_run.message());
    CRAFTFLEET_RETURN_IF_ERROR(same_run);
    service_->sessions_[this] = {hello.client(), context->peer(), 0, &meter_, context, &idle_since_};
    return absl::OkStatus();
  }
  void SetLanes(int lanes) {
    MutexLock lock(&service_->mu_);
    service_->sessions_[this].lanes = lanes;
    service_->changed_.NotifyAll();
  }
  // Adds the server's summary to a reply, at intervals.
  void AddSummary(v1::PlayReply* reply) {
    reply->clear_server();
    if (service_->clock_.Now() < next_summary_) return;
    next_summary_ = service_->clock_.Now() + kSummarizeEvery;
    *reply->mutable_server() = service_->RecentSummary();
  }
  ActivityMeter* meter() { return &meter_; }
  // The session waits for its client, or is served again.
  void SetIdle(bool idle) { idle_since_ = idle ? absl::ToUnixNanos(SteadyNow()) : 0; }

 private:
  EnvServiceImpl* const service_;
  ActivityMeter meter_;
  absl::Time next_summary_ = absl::InfinitePast();
  std::atomic<int64_t> idle_since_{0};
};

absl::Status EnvServiceImpl::Options::Validate() const {
  CRAFTFLEET_RETURN_IF_ERROR(budget.Validate());
  const std::pair<const char*, absl::Duration> timeouts[] = {
      {"hello_timeout", hello_timeout}, {"idle_timeout", idle_timeout}, {"reply_timeout", reply_timeout}};
  for (const auto& [flag, timeout] : timeouts) {
    if (timeout >= absl::Seconds(1)) continue;
    return absl::InvalidArgumentError(
        absl::StrFormat("--%s=%s, want at least 1s", flag, absl::FormatDuration(timeout)));
  }
  return absl::OkStatus();
}

absl::StatusOr<std::unique_ptr<EnvServiceImpl>> EnvServiceImpl::Create(const std::string& texture_dir) {
  return Create(texture_dir, {});
}

absl::StatusOr<std::unique_ptr<EnvServiceImpl>> EnvServiceImpl::Create(const std::string& texture_dir,
                                                                       const Options& options) {
  CRAFTFLEET_RETURN_IF_ERROR(options.Validate());
  std::shared_ptr<const Textures> textures;
  std::string digest;
  if (texture_dir.empty()) {
    textures = Textures::BuiltIn();
    digest = TextureDigest(BuiltInTextures());
  } else {
    CRAFTFLEET_ASSIGN_OR_RETURN(textures, Textures::Load(texture_dir));
    CRAFTFLEET_ASSIGN_OR_RETURN(digest, TextureDigest(texture_dir));
  }
  CRAFTFLEET_ASSIGN_OR_RETURN(std::string canary, GameCanary(*textures));
  return std::unique_ptr<EnvServiceImpl>(
      new EnvServiceImpl(std::move(textures), std::move(digest), std::move(canary), options));
}

EnvServiceImpl::EnvServiceImpl(std::shared_ptr<const Textures> textures, std::string texture_digest, std::string canary,
                               const Options& options)
    : textures_(std::move(textures)),
      texture_digest_(std::move(texture_digest)),
      canary_(std::move(canary)),
      options_(options),
      budget_(options.budget, [this] { EndIdlest(); }) {}

void EnvServiceImpl::SetRun(absl::string_view run_id) {
  const MutexLock lock(&mu_);
  own_run_id_ = std::string(run_id);
}

grpc::Status EnvServiceImpl::Play(grpc::ServerContext* context,
                                  grpc::ServerReaderWriter<v1::PlayReply, v1::PlayRequest>* stream) {
  wire::StreamWatch::Stream watched(&watch_, context);
  absl::Status status = watched.admitted();
  try {
    if (status.ok()) status = Serve(context, &watched, stream);
  } catch (const std::exception& error) {  // from a library, or out of memory
    status =
        absl::AbortedError(absl::StrCat("the environment failed (", error.what(), "): continue from the snapshots"));
  }
  if (const absl::Status late = watched.late(); !late.ok()) status = late;
  if (absl::IsCancelled(status)) return wire::ToGrpc(status);  // by the client or by this server
  if (!status.ok()) {
    ++rejected_;
    log_.Warn(wire::ClientOfPeer(context->peer()),
              absl::StrFormat("session of %s ended: %s", context->peer(), status.message()));
  }
  return wire::ToGrpc(status);
}

absl::Status EnvServiceImpl::Serve(grpc::ServerContext* context, wire::StreamWatch::Stream* watched,
                                   grpc::ServerReaderWriter<v1::PlayReply, v1::PlayRequest>* stream) {
  v1::PlayRequest request;
  v1::PlayReply reply;
  watched->Await("a hello (--hello_timeout)", options_.hello_timeout);
  const bool received = stream->Read(&request);
  watched->Work();
  if (!received && context->IsCancelled()) return absl::OkStatus();
  if (!received || !request.has_hello()) return absl::InvalidArgumentError("a session begins with hello");
  GameBudget::Share share(&budget_);
  CRAFTFLEET_ASSIGN_OR_RETURN(EnvBatch batch, Greet(request.hello(), &share));
  batch.StopWhen([context] { return context->IsCancelled(); });
  SessionGuard session(this);
  CRAFTFLEET_RETURN_IF_ERROR(session.Enter(request.hello(), context));
  reply.set_program_version(std::string(ProgramVersion()));
  reply.set_canary(canary_);
  reply.set_frame_format(static_cast<v1::FrameFormat>(batch.format()));
  StepBatch step;
  while (true) {
    const absl::Duration busy = session.meter()->Switch(Activity::kWire);
    reply.set_busy_ns(absl::ToInt64Nanoseconds(busy));
    session.AddSummary(&reply);
    watched->Await("a reply to be taken (--reply_timeout)", options_.reply_timeout);
    if (!stream->Write(reply)) return absl::OkStatus();
    session.meter()->Switch(Activity::kIdle);
    session.SetIdle(true);
    request = v1::PlayRequest();  // a session that waits must not keep megabytes of its last request
    watched->Await("the next request (--idle_timeout)", options_.idle_timeout);
    if (!stream->Read(&request)) return absl::OkStatus();
    session.SetIdle(false);
    watched->Work();
    session.meter()->Switch(Activity::kEnvironment);
    reply.clear_program_version();
    reply.clear_canary();
    reply.clear_frame_format();
    CRAFTFLEET_RETURN_IF_ERROR(Handle(request, &batch, &share, &step, &reply));
    if (request.has_step()) {
      session.meter()->Count(request.step().lanes_size());
    } else {
      session.SetLanes(batch.size());
    }
  }
}

absl::StatusOr<EnvBatch> EnvServiceImpl::Greet(const v1::SessionHello& hello, GameBudget::Share* share) const {
  const wire::Handshake ours = {wire::kProtocolVersion, "", texture_digest_};
  const wire::Handshake theirs = {hello.protocol_version(), hello.run_id(), hello.texture_digest()};
  CRAFTFLEET_RETURN_IF_ERROR(wire::CheckHandshake("environment server", ours, "actor", theirs));
  if (!hello.game_canary().empty() && hello.game_canary() != canary_) {
    return absl::FailedPreconditionError(absl::StrFormat(
        "this environment server (build %s) plays another game than the run: canary %s, want %s; run the same build "
        "everywhere",
        BuildId(), canary_, absl::CHexEscape(hello.game_canary().substr(0, 64))));
  }
  CRAFTFLEET_RETURN_IF_ERROR(wire::CheckText("client", hello.client()));
  CRAFTFLEET_RETURN_IF_ERROR(wire::CheckText("run_id", hello.run_id()));
  CRAFTFLEET_ASSIGN_OR_RETURN(const EnvName name, EnvName::Parse(hello.env().name()));
  WorldOptions world = WorldOptions::FromEnvName(name);
  if (hello.env().length() != 0) world.length = hello.env().length();
  CRAFTFLEET_RETURN_IF_ERROR(world.Validate());
  RenderOptions picture;
  picture.width = hello.env().frame_size();
  picture.height = hello.env().frame_size();
  picture.inventory = name.inventory;
  CRAFTFLEET_RETURN_IF_ERROR(picture.Validate(world));
  RenderOptions larger_picture = picture;
  larger_picture.width = hello.recording().picture_size();
  larger_picture.height = hello.recording().picture_size();
  const bool larger_wanted = larger_picture.width != 0;
  if (larger_wanted) CRAFTFLEET_RETURN_IF_ERROR(larger_picture.Validate(world));
  // A renderer's tables are as large as some pictures.
  CRAFTFLEET_RETURN_IF_ERROR(share->Set(
      0, SessionBytes(0, FrameBytes(picture), hello.has_recording(), larger_wanted ? FrameBytes(larger_picture) : 0)));
  CRAFTFLEET_ASSIGN_OR_RETURN(std::shared_ptr<const Renderer> renderer, Renderer::Create(*textures_, world, picture));
  if (!hello.has_recording()) return EnvBatch(std::move(renderer), std::nullopt, ChooseFormat(hello));
  std::shared_ptr<const Renderer> larger;
  if (larger_wanted) {
    CRAFTFLEET_ASSIGN_OR_RETURN(larger, Renderer::Create(*textures_, world, larger_picture));
  }
  return EnvBatch(std::move(renderer), MomentTaker(std::move(larger)));
}

absl::Status EnvServiceImpl::Handle(const v1::PlayRequest& request, EnvBatch* batch, GameBudget::Share* share,
                                    StepBatch* step, v1::PlayReply* reply) {
  switch (request.request_case()) {
    case v1::PlayRequest::kStep: {
      std::vector<Action> actions;
      CRAFTFLEET_RETURN_IF_ERROR(wire::ActionsFromProto(request.step(), &actions));
      CRAFTFLEET_RETURN_IF_ERROR(batch->Step(request.step().lanes(), actions, request.step().snapshot(), step));
      episodes_ += static_cast<int64_t>(step->episodes.size());
      reply->clear_refused();
      wire::ToProto(step, reply);
      Pack(batch->format(), reply);
      wire::ToProto(std::move(batch->moments()), reply);
      return absl::OkStatus();
    }
    case v1::PlayRequest::kOpen: {
      CRAFTFLEET_RETURN_IF_ERROR(SetGames(int64_t{batch->size()} + request.open().lanes_size(), *batch, share));
      std::vector<EnvBatch::OpenLane> lanes;
      for (const v1::OpenLanes::Lane& lane : request.open().lanes()) {
        lanes.push_back({lane.lane(), lane.seed(), lane.episode() == 0 ? 1 : lane.episode(), lane.snapshot()});
      }
      reply->Clear();
      CRAFTFLEET_RETURN_IF_ERROR(batch->Open(lanes, reply->mutable_frames()));
      Pack(batch->format(), reply);
      AddRefused(batch->refused(), &log_, reply);
      wire::ToProto(std::move(batch->moments()), reply);
      return SetGames(batch->size(), *batch, share);  // some lanes may have been open already
    }
    case v1::PlayRequest::kClose:
      reply->Clear();
      batch->Close(request.close().lanes());
      return SetGames(batch->size(), *batch, share);
    case v1::PlayRequest::kHello:
      return absl::InvalidArgumentError("hello came twice");
    case v1::PlayRequest::REQUEST_NOT_SET:
      break;
  }
  return absl::InvalidArgumentError("an empty request, want open, step or close");
}

void EnvServiceImpl::EndIdlest() {
  const MutexLock lock(&mu_);
  const Session* idlest = nullptr;
  int64_t idlest_since = std::numeric_limits<int64_t>::max();
  for (const auto& [key, session] : sessions_) {
    const int64_t since = *session.idle_since;
    if (session.lanes == 0 || since == 0 || since >= idlest_since) continue;
    idlest = &session;
    idlest_since = since;
  }
  if (idlest == nullptr) return;
  const absl::Duration idle = SteadyNow() - absl::FromUnixNanos(idlest_since);
  if (idle < options_.gives_way) return;
  log_.Warn("idle", absl::StrFormat("session of %s ended: it sent nothing for %s while others need room for games",
                                    idlest->address, absl::FormatDuration(absl::Trunc(idle, absl::Milliseconds(1)))));
  idlest->context->TryCancel();
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

Work EnvServiceImpl::TotalWork() const {
  const MutexLock lock(&mu_);
  return TotalWorkLocked();
}

Work EnvServiceImpl::TotalWorkLocked() const {
  Work work = ended_;
  for (const auto& [key, session] : sessions_) work.Add(session.meter->Total());
  return work;
}

v1::ProcessSummary EnvServiceImpl::Summary() const {
  const MutexLock lock(&mu_);
  return SummaryLocked();
}

v1::ProcessSummary EnvServiceImpl::SummaryLocked() const {
  v1::ProcessSummary summary;
  Work recent;
  int lanes = 0;
  for (const auto& [key, session] : sessions_) {
    recent.Add(session.meter->Recent());
    lanes += session.lanes;
  }
  summary.set_lanes(lanes);
  summary.set_policy_version(-1);
  wire::FillWork(TotalWorkLocked(), recent, static_cast<int>(sessions_.size()), &summary);
  wire::FillUsage(&summary);
  return summary;
}

v1::ProcessSummary EnvServiceImpl::RecentSummary() {
  const MutexLock lock(&mu_);
  if (clock_.Now() - summarized_ >= kSummarizeEvery) {
    summarized_ = clock_.Now();
    recent_summary_ = SummaryLocked();
  }
  return recent_summary_;
}

void EnvServiceImpl::FillStatus(v1::StatusReply* reply) const {
  const MutexLock lock(&mu_);
  reply->set_run_id(run_id_);
  for (const auto& [key, session] : sessions_) {
    v1::Peer* peer = reply->add_peers();
    peer->set_name(session.client);
    peer->set_role("actor");
    peer->set_address(session.address);
    peer->set_state(absl::StrFormat("%d lanes", session.lanes));
  }
  *reply->mutable_summary() = SummaryLocked();
  wire::AddMetric("sessions", static_cast<double>(sessions_.size()), reply);
  wire::AddMetric("sessions_rejected", static_cast<double>(rejected_.load()), reply);
  wire::AddMetric("env_steps", static_cast<double>(TotalWorkLocked().done), reply);
  wire::AddMetric("games_memory", static_cast<double>(budget_.bytes()), reply);
  wire::AddMetric("episodes", static_cast<double>(episodes_.load()), reply);
}

}  // namespace craftfleet
