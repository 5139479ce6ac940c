#include "actor/env_client.h"

#include <utility>

#include <absl/strings/escaping.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>

#include "common/status_macros.h"
#include "common/wire/convert.h"
#include "common/wire/grpc_status.h"

namespace craftfleet {

EnvClient::EnvClient(const wire::Endpoint& server, v1::SessionHello hello, int frame_bytes)
    : server_(wire::ConnectApart(server)),
      hello_(std::move(hello)),
      frame_bytes_(frame_bytes),
      stub_(v1::EnvironmentService::NewStub(server_.channel)) {}

EnvClient::~EnvClient() { Disconnect(); }

absl::Status EnvClient::Connect(absl::Duration timeout) {
  Disconnect();
  CRAFTFLEET_RETURN_IF_ERROR(wire::WaitUntilConnected("environment server", server_, timeout));
  {
    MutexLock lock(&mu_);
    if (cancelled_) return absl::CancelledError("stopping");
    context_ = std::make_unique<grpc::ClientContext>();
    stream_ = stub_->Play(context_.get());
  }
  *request_.mutable_hello() = hello_;
  CRAFTFLEET_RETURN_IF_ERROR(Send());
  CRAFTFLEET_RETURN_IF_ERROR(Receive());
  return CheckCanary();
}

absl::Status EnvClient::CheckCanary() {
  if (hello_.game_canary().empty() || reply_.canary() == hello_.game_canary()) return absl::OkStatus();
  Disconnect();
  return absl::FailedPreconditionError(absl::StrFormat(
      "environment server %s plays another game: its canary is %s, want %s: run the same build everywhere",
      server_.address, reply_.canary().empty() ? "none" : absl::CHexEscape(reply_.canary().substr(0, 64)),
      hello_.game_canary()));
}

bool EnvClient::Reachable() const {
  return server_.address == wire::kInProcess ||
         server_.channel->GetState(/*try_to_connect=*/true) == GRPC_CHANNEL_READY;
}

bool EnvClient::Failing() const {
  return server_.address != wire::kInProcess &&
         server_.channel->GetState(/*try_to_connect=*/false) == GRPC_CHANNEL_TRANSIENT_FAILURE;
}

absl::Status EnvClient::Open(absl::Span<const Lane> lanes, std::string* frames) {
  v1::OpenLanes* open = request_.mutable_open();
  open->Clear();
  for (const Lane& lane : lanes) {
    v1::OpenLanes::Lane* message = open->add_lanes();
    message->set_lane(lane.lane);
    message->set_seed(lane.seed);
    message->set_episode(lane.episode);
    message->set_snapshot(lane.snapshot);
  }
  CRAFTFLEET_RETURN_IF_ERROR(Send());
  CRAFTFLEET_RETURN_IF_ERROR(Receive());
  const size_t wanted = lanes.size() * frame_bytes_;
  if (reply_.frames().size() != wanted) {
    return absl::InternalError(absl::StrFormat("environment server %s: %d bytes of frames, want %d", server_.address,
                                               reply_.frames().size(), wanted));
  }
  frames->swap(*reply_.mutable_frames());
  return TakeMoments(lanes.size());
}

absl::Status EnvClient::Close(absl::Span<const int> lanes) {
  request_.mutable_close()->mutable_lanes()->Assign(lanes.begin(), lanes.end());
  CRAFTFLEET_RETURN_IF_ERROR(Send());
  return Receive();
}

absl::Status EnvClient::SendStep(absl::Span<const int> lanes, absl::Span<const Action> actions, bool snapshot) {
  v1::StepLanes* step = request_.mutable_step();
  step->mutable_lanes()->Assign(lanes.begin(), lanes.end());
  step->mutable_actions()->assign(reinterpret_cast<const char*>(actions.data()), actions.size());
  step->set_snapshot(snapshot);
  lanes_sent_ = static_cast<int>(lanes.size());
  return Send();
}

absl::Status EnvClient::ReceiveStep(StepBatch* batch) {
  CRAFTFLEET_RETURN_IF_ERROR(Receive());
  const absl::Status status = wire::FromProto(&reply_, lanes_sent_, frame_bytes_, batch);
  if (status.ok()) return TakeMoments(lanes_sent_);
  return absl::InternalError(absl::StrCat("environment server ", server_.address, ": ", status.message()));
}

absl::Status EnvClient::TakeMoments(size_t lanes) {
  if (!hello_.has_recording()) return absl::OkStatus();
  const int size = hello_.recording().picture_size();
  absl::StatusOr<std::vector<Moment>> moments =
      wire::MomentsFromProto(&reply_, static_cast<int>(lanes), frame_bytes_, size * size * 3);
  if (!moments.ok()) {
    return absl::InternalError(absl::StrCat("environment server ", server_.address, ": ", moments.status().message()));
  }
  moments_ = *std::move(moments);
  return absl::OkStatus();
}

void EnvClient::Cancel() {
  MutexLock lock(&mu_);
  cancelled_ = true;
  if (context_ != nullptr) context_->TryCancel();
}

void EnvClient::Disconnect() {
  if (stream_ == nullptr) return;
  {
    MutexLock lock(&mu_);
    context_->TryCancel();
  }
  stream_->Finish();
  stream_ = nullptr;
}

absl::Status EnvClient::Send() { return stream_ != nullptr && stream_->Write(request_) ? absl::OkStatus() : Broken(); }

absl::Status EnvClient::Receive() {
  if (stream_ == nullptr || !stream_->Read(&reply_)) return Broken();
  if (reply_.has_server()) summary_.Swap(reply_.mutable_server());
  return absl::OkStatus();
}

absl::Status EnvClient::Broken() {
  const std::string context = absl::StrCat("environment server ", server_.address);
  if (stream_ == nullptr) return absl::UnavailableError(absl::StrCat(context, ": not connected"));
  stream_->WritesDone();
  const absl::Status status = wire::FromCall(stream_->Finish(), context, server_);
  stream_ = nullptr;
  MutexLock lock(&mu_);
  if (cancelled_) return absl::CancelledError("stopping");
  // A server that stops may end its sessions by OK or by Cancelled; the latter would read as if we were stopping.
  const bool stopped = status.ok() || status.code() == absl::StatusCode::kCancelled;
  return stopped ? absl::UnavailableError(absl::StrCat(context, ": ended the session")) : status;
}

}  // namespace craftfleet
