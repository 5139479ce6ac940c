#include "actor/env_client.h"

#include <algorithm>
#include <iterator>
#include <utility>

#include <absl/strings/escaping.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>

#include "common/base/clock.h"
#include "common/base/status_macros.h"
#include "common/io/snapshot_envelope.h"
#include "common/wire/convert.h"
#include "common/wire/grpc_status.h"
#include "common/wire/protocol.h"

namespace craftfleet {

namespace {

// Additional time for opening one game, as a fraction of the timeout.
constexpr double kForAGame = 0.01;
// At least the bytes that a reply has for one game besides pictures and snapshot: an episode, a map of 64 x 64 cells.
constexpr size_t kRestOfGame = 8 << 10;
constexpr absl::Duration kSummaryLasts = absl::Seconds(5);  // a server that plays sends one each second
// The minimum time for a reply after other servers' replies were read first, as a fraction of the timeout.
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

// Appends the results of further rows.
void Append(StepBatch rows, StepBatch* batch) {
  batch->frames += rows.frames;
  batch->last_frames += rows.last_frames;
  batch->rewards.insert(batch->rewards.end(), rows.rewards.begin(), rows.rewards.end());
  batch->ends.insert(batch->ends.end(), rows.ends.begin(), rows.ends.end());
  batch->episodes.insert(batch->episodes.end(), rows.episodes.begin(), rows.episodes.end());
  std::move(rows.snapshots.begin(), rows.snapshots.end(), std::back_inserter(batch->snapshots));
}

}  // namespace

EnvClient::EnvClient(const wire::Endpoint& server, v1::SessionHello hello, int frame_bytes, absl::Duration timeout)
    : server_(wire::ConnectApart(server)),
      hello_(std::move(hello)),
      frame_bytes_(frame_bytes),
      timeout_(timeout),
      check_(hello_, frame_bytes),
      lengths_(check_.max_length()),
      frames_(hello_, frame_bytes),
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
    // The call starts with hello, which has a deadline. Without this, a server that accepts no calls could block here.
    context_->set_initial_metadata_corked(true);
    stream_ = stub_->Play(context_.get());
  }
  lengths_.Clear();
  *request_.mutable_hello() = hello_;
  CRAFTFLEET_RETURN_IF_ERROR(Send(timeout_));
  CRAFTFLEET_RETURN_IF_ERROR(Receive());
  CRAFTFLEET_RETURN_IF_ERROR(EndIfInvalid(check_.Hello(reply_)));
  CRAFTFLEET_RETURN_IF_ERROR(EndIfInvalid(frames_.Begin(reply_)));
  return CheckCanary();
}

absl::Status EnvClient::CheckCanary() {
  if (hello_.game_canary().empty() || reply_.canary() == hello_.game_canary()) return absl::OkStatus();
  absl::Status error = absl::FailedPreconditionError(absl::StrFormat(
      "environment server %s plays another game: its canary is %s, want %s; run the same build everywhere",
      server_.address, reply_.canary().empty() ? "none" : absl::CHexEscape(reply_.canary().substr(0, 64)),
      hello_.game_canary()));
  Disconnect();
  return error;
}

bool EnvClient::Reachable() const {
  return server_.address == wire::kInProcess ||
         server_.channel->GetState(/*try_to_connect=*/true) == GRPC_CHANNEL_READY;
}

bool EnvClient::Failing() const {
  return server_.address != wire::kInProcess &&
         server_.channel->GetState(/*try_to_connect=*/false) == GRPC_CHANNEL_TRANSIENT_FAILURE;
}

v1::ProcessSummary EnvClient::summary() const {
  return SteadyNow() - summarized_ < kSummaryLasts ? summary_ : v1::ProcessSummary();
}

absl::Status EnvClient::Open(absl::Span<const Lane> lanes, std::string* frames, std::vector<Refused>* refused) {
  frames->clear();
  moments_.clear();
  records_.clear();
  const size_t at_once = std::min(kOpenAtOnce, GamesPerReply(/*snapshot=*/false));
  absl::Duration busy;
  for (size_t first = 0; first < lanes.size(); first += at_once) {
    CRAFTFLEET_RETURN_IF_ERROR(OpenSome(lanes.subspan(first, at_once), frames, refused));
    busy += busy_;
  }
  busy_ = busy;
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
  CRAFTFLEET_RETURN_IF_ERROR(EndIfInvalid(frames_.ReadOpened(request_.open(), &reply_, &records_)));
  CRAFTFLEET_RETURN_IF_ERROR(EndIfInvalid(check_.Open(request_.open(), reply_)));
  CRAFTFLEET_RETURN_IF_ERROR(EndIfInvalid(lengths_.Open(request_.open(), reply_)));
  if (frames->empty()) {
    frames->swap(*reply_.mutable_frames());
  } else {
    frames->append(reply_.frames());
  }
  for (const v1::RefusedLane& lane : reply_.refused()) refused->push_back({lane.lane(), CutReason(lane.reason())});
  return TakeMoments(lanes.size() - reply_.refused_size());
}

absl::Status EnvClient::Close(absl::Span<const int> lanes) {
  frames_.Close(lanes);
  request_.mutable_close()->mutable_lanes()->Assign(lanes.begin(), lanes.end());
  CRAFTFLEET_RETURN_IF_ERROR(Send(timeout_));
  CRAFTFLEET_RETURN_IF_ERROR(Receive());
  return EndIfInvalid(check_.Close(reply_));
}

size_t EnvClient::GamesPerReply(bool snapshot) const {
  const auto frame = static_cast<size_t>(frame_bytes_);
  size_t game = 2 * frame + kRestOfGame;  // the frame, and the last one of a truncated episode
  if (snapshot) game += kMaxSnapshotBytes;
  if (hello_.has_recording()) {
    const size_t size = hello_.recording().picture_size();
    game += frame + size * size * 3;
  }
  return std::max<size_t>(wire::kMaxMessageBytes / game, 1);
}

absl::Status EnvClient::SendStep(absl::Span<const int> lanes, absl::Span<const Action> actions, bool snapshot) {
  step_.mutable_lanes()->Assign(lanes.begin(), lanes.end());
  step_.mutable_actions()->assign(reinterpret_cast<const char*>(actions.data()), actions.size());
  step_.set_snapshot(snapshot);
  sent_rows_ = 0;
  return SendRows();
}

absl::Status EnvClient::SendRows() {
  const int count = std::min(RowsWaiting(), static_cast<int>(GamesPerReply(step_.snapshot())));
  const auto first = step_.lanes().begin() + sent_rows_;
  v1::StepLanes* step = request_.mutable_step();
  step->mutable_lanes()->Assign(first, first + count);
  step->mutable_actions()->assign(step_.actions(), sent_rows_, count);
  step->set_snapshot(step_.snapshot());
  sent_rows_ += count;
  return Send(timeout_);
}

absl::Status EnvClient::ReceiveStep(StepBatch* batch) {
  moments_.clear();
  records_.clear();
  CRAFTFLEET_RETURN_IF_ERROR(ReceiveRows(batch));
  absl::Duration busy = busy_;
  while (RowsWaiting() > 0) {
    CRAFTFLEET_RETURN_IF_ERROR(SendRows());
    StepBatch rows;
    CRAFTFLEET_RETURN_IF_ERROR(ReceiveRows(&rows));
    Append(std::move(rows), batch);
    busy += busy_;
  }
  busy_ = busy;
  return absl::OkStatus();
}

absl::Status EnvClient::ReceiveRows(StepBatch* batch) {
  CRAFTFLEET_RETURN_IF_ERROR(Receive());
  CRAFTFLEET_RETURN_IF_ERROR(EndIfInvalid(frames_.ReadStep(request_.step(), &reply_, &records_)));
  CRAFTFLEET_RETURN_IF_ERROR(EndIfInvalid(check_.Step(request_.step(), reply_)));
  const int lanes = request_.step().lanes_size();
  CRAFTFLEET_RETURN_IF_ERROR(EndIfInvalid(wire::FromProto(&reply_, lanes, frame_bytes_, check_.max_length(), batch)));
  CRAFTFLEET_RETURN_IF_ERROR(EndIfInvalid(lengths_.Step(request_.step(), reply_)));
  return TakeMoments(lanes);
}

absl::Status EnvClient::TakeMoments(size_t lanes) {
  const int size = hello_.recording().picture_size();
  absl::StatusOr<std::vector<Moment>> moments = wire::MomentsFromProto(
      &reply_, hello_.has_recording() ? static_cast<int>(lanes) : 0, frame_bytes_, size * size * 3);
  CRAFTFLEET_RETURN_IF_ERROR(EndIfInvalid(moments.status()));
  std::move(moments->begin(), moments->end(), std::back_inserter(moments_));
  return absl::OkStatus();
}

absl::Status EnvClient::EndIfInvalid(const absl::Status& checked) {
  if (checked.ok()) {
    if (reply_.has_server()) {
      summary_ = reply_.server();
      summarized_ = SteadyNow();
    }
    return checked;
  }
  Disconnect();
  // Of the reply, not of the request.
  const bool is_invalid = checked.code() == absl::StatusCode::kInvalidArgument;
  return {is_invalid ? absl::StatusCode::kDataLoss : checked.code(),
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
  EndSession();
}

void EnvClient::Disconnect() {
  if (stream_ == nullptr) return;
  {
    MutexLock lock(&mu_);
    context_->TryCancel();
  }
  stream_->Finish();
  EndSession();
}

void EnvClient::EndSession() {
  stream_ = nullptr;
  reply_ = v1::PlayReply();
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
  busy_ = absl::Nanoseconds(reply_.busy_ns());
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
  EndSession();
  MutexLock lock(&mu_);
  if (cancelled_) return absl::CancelledError("stopping");
  if (overdue_) {
    return absl::DeadlineExceededError(
        absl::StrCat(context, ": no answer within ", absl::FormatDuration(limit_), " to ", DescribeRequest(request_)));
  }
  // A stopping server may end its sessions with OK or Cancelled, but Cancelled would mean that this actor is stopping.
  const bool stopped = status.ok() || status.code() == absl::StatusCode::kCancelled;
  if (stopped) return absl::UnavailableError(absl::StrCat(context, ": ended the session"));
  // It was this actor that let the server wait, as while the run is paused: it has missed no deadline.
  return absl::IsDeadlineExceeded(status) ? absl::UnavailableError(status.message()) : status;
}

}  // namespace craftfleet
