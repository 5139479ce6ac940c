#include "actor/env_client.h"

#include <algorithm>
#include <iterator>
#include <utility>

#include <absl/strings/escaping.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>

#include "common/clock.h"
#include "common/status_macros.h"
#include "common/wire/convert.h"
#include "common/wire/grpc_status.h"

namespace craftfleet {

namespace {

// What opening a game may take more than a step, in parts of the timeout.
constexpr double kForAGame = 0.01;
// A reply that waits to be read, since others were read before it, has this part of the timeout at least.
constexpr double kForReading = 0.1;

std::string DescribeRequest(const v1::PlayRequest& request) {
  switch (request.request_case()) {
    case v1::PlayRequest::kHello:
      return "hello";
    case v1::PlayRequest::kOpen:
      return absl::StrCat("open of ", request.open().lanes_size(), " games");
    case v1::PlayRequest::kStep:
      return absl::StrCat("a step of ", request.step().lanes_size(), " games");
    default:
      return "close";
  }
}

}  // namespace

EnvClient::EnvClient(const wire::Endpoint& server, v1::SessionHello hello, int frame_bytes, absl::Duration timeout)
    : server_(wire::ConnectApart(server)),
      hello_(std::move(hello)),
      frame_bytes_(frame_bytes),
      timeout_(timeout),
      check_(hello_, frame_bytes),
      stub_(v1::EnvironmentService::NewStub(server_.channel)),
      timer_(Watchdog::OfProcess(), [this] {
        const MutexLock lock(&mu_);
        if (context_ != nullptr) context_->TryCancel();
      }) {}

EnvClient::~EnvClient() { Disconnect(); }

absl::Status EnvClient::Connect(absl::Duration patience) {
  Disconnect();
  CRAFTFLEET_RETURN_IF_ERROR(wire::WaitUntilConnected("environment server", server_, patience));
  {
    MutexLock lock(&mu_);
    if (cancelled_) return absl::CancelledError("stopping");
    context_ = std::make_unique<grpc::ClientContext>();
    // The call begins with hello, which has a deadline: to begin it now could wait for a server that takes no calls.
    context_->set_initial_metadata_corked(true);
    stream_ = stub_->Play(context_.get());
  }
  *request_.mutable_hello() = hello_;
  CRAFTFLEET_RETURN_IF_ERROR(Send(timeout_));
  CRAFTFLEET_RETURN_IF_ERROR(Receive());
  CRAFTFLEET_RETURN_IF_ERROR(Judge(check_.Hello(reply_)));
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

absl::Status EnvClient::Open(absl::Span<const Lane> lanes, std::string* frames, std::vector<Refused>* refused) {
  frames->clear();
  moments_.clear();
  for (size_t first = 0; first < lanes.size(); first += kOpenAtOnce) {
    CRAFTFLEET_RETURN_IF_ERROR(OpenSome(lanes.subspan(first, kOpenAtOnce), frames, refused));
  }
  return absl::OkStatus();
}

absl::Status EnvClient::OpenSome(absl::Span<const Lane> lanes, std::string* frames, std::vector<Refused>* refused) {
  v1::OpenLanes* open = request_.mutable_open();
  open->Clear();
  for (const Lane& lane : lanes) {
    v1::OpenLanes::Lane* message = open->add_lanes();
    message->set_lane(lane.lane);
    message->set_seed(lane.seed);
    message->set_episode(lane.episode);
    message->set_snapshot(lane.snapshot);
  }
  CRAFTFLEET_RETURN_IF_ERROR(Send(timeout_ * (1 + kForAGame * static_cast<double>(lanes.size()))));
  CRAFTFLEET_RETURN_IF_ERROR(Receive());
  CRAFTFLEET_RETURN_IF_ERROR(Judge(check_.Open(request_.open(), reply_)));
  if (frames->empty()) {
    frames->swap(*reply_.mutable_frames());
  } else {
    frames->append(reply_.frames());
  }
  for (const v1::RefusedLane& lane : reply_.refused()) refused->push_back({lane.lane(), CutReason(lane.reason())});
  return TakeMoments(lanes.size() - reply_.refused_size());
}

absl::Status EnvClient::Close(absl::Span<const int> lanes) {
  request_.mutable_close()->mutable_lanes()->Assign(lanes.begin(), lanes.end());
  CRAFTFLEET_RETURN_IF_ERROR(Send(timeout_));
  CRAFTFLEET_RETURN_IF_ERROR(Receive());
  return Judge(check_.Close(reply_));
}

absl::Status EnvClient::SendStep(absl::Span<const int> lanes, absl::Span<const Action> actions, bool snapshot) {
  v1::StepLanes* step = request_.mutable_step();
  step->mutable_lanes()->Assign(lanes.begin(), lanes.end());
  step->mutable_actions()->assign(reinterpret_cast<const char*>(actions.data()), actions.size());
  step->set_snapshot(snapshot);
  return Send(timeout_);
}

absl::Status EnvClient::ReceiveStep(StepBatch* batch) {
  CRAFTFLEET_RETURN_IF_ERROR(Receive());
  CRAFTFLEET_RETURN_IF_ERROR(Judge(check_.Step(request_.step(), reply_)));
  moments_.clear();
  const int lanes = request_.step().lanes_size();
  CRAFTFLEET_RETURN_IF_ERROR(Judge(wire::FromProto(&reply_, lanes, frame_bytes_, batch)));
  return TakeMoments(lanes);
}

absl::Status EnvClient::TakeMoments(size_t lanes) {
  if (!hello_.has_recording()) return absl::OkStatus();
  const int size = hello_.recording().picture_size();
  absl::StatusOr<std::vector<Moment>> moments =
      wire::MomentsFromProto(&reply_, static_cast<int>(lanes), frame_bytes_, size * size * 3);
  CRAFTFLEET_RETURN_IF_ERROR(Judge(moments.status()));
  std::move(moments->begin(), moments->end(), std::back_inserter(moments_));
  return absl::OkStatus();
}

absl::Status EnvClient::Judge(const absl::Status& checked) {
  if (checked.ok()) {
    if (reply_.has_server()) summary_ = reply_.server();
    return checked;
  }
  Disconnect();
  // What is no shape to convert.h is nonsense, too.
  const bool is_nonsense = checked.code() == absl::StatusCode::kInvalidArgument;
  return {is_nonsense ? absl::StatusCode::kDataLoss : checked.code(),
          absl::StrCat("environment server ", server_.address, ": ", checked.message())};
}

void EnvClient::Cancel() {
  MutexLock lock(&mu_);
  cancelled_ = true;
  if (context_ != nullptr) context_->TryCancel();
}

void EnvClient::Leave() {
  if (stream_ == nullptr) return;
  timer_.Arm(timeout_);
  stream_->WritesDone();
  stream_->Finish();
  timer_.Disarm();
  stream_ = nullptr;
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

absl::Status EnvClient::Send(absl::Duration limit) {
  if (stream_ == nullptr) return Broken();
  limit_ = limit;
  sent_ = SteadyNow();
  timer_.Arm(limit_);
  const bool sent = stream_->Write(request_);
  overdue_ = timer_.Disarm();
  return sent && !overdue_ ? absl::OkStatus() : Broken();
}

absl::Status EnvClient::Receive() {
  if (stream_ == nullptr) return Broken();
  timer_.Arm(std::max(limit_ - (SteadyNow() - sent_), limit_ * kForReading));
  const bool received = stream_->Read(&reply_);
  overdue_ = timer_.Disarm();
  return received && !overdue_ ? absl::OkStatus() : Broken();
}

absl::Status EnvClient::Broken() {
  const std::string context = absl::StrCat("environment server ", server_.address);
  if (stream_ == nullptr) return absl::UnavailableError(absl::StrCat(context, ": not connected"));
  {
    MutexLock lock(&mu_);
    if (overdue_) context_->TryCancel();
  }
  stream_->WritesDone();
  const absl::Status status = wire::FromCall(stream_->Finish(), context, server_);
  stream_ = nullptr;
  MutexLock lock(&mu_);
  if (cancelled_) return absl::CancelledError("stopping");
  if (overdue_) {
    return absl::DeadlineExceededError(
        absl::StrCat(context, ": no answer within ", absl::FormatDuration(limit_), " to ", DescribeRequest(request_)));
  }
  // A server that stops may end its sessions by OK or by Cancelled; the latter would read as if we were stopping.
  const bool stopped = status.ok() || status.code() == absl::StatusCode::kCancelled;
  return stopped ? absl::UnavailableError(absl::StrCat(context, ": ended the session")) : status;
}

}  // namespace craftfleet
