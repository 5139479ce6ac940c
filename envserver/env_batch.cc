#include "envserver/env_batch.h"

#include <algorithm>
#include <utility>

#include <absl/strings/str_format.h>

#include "common/base/clock.h"
#include "common/base/status_macros.h"
#include "envserver/game_budget.h"

namespace craftfleet {
namespace {

constexpr absl::Duration kCheckEvery = absl::Milliseconds(50);
constexpr size_t kGamesPerCheck = 16;  // small games take microseconds a step

absl::Span<uint8_t> Row(std::string* frames, size_t row, size_t frame_bytes) {
  return absl::MakeSpan(reinterpret_cast<uint8_t*>(&(*frames)[row * frame_bytes]), frame_bytes);
}

absl::Status CheckDistinct(std::vector<int> lanes, absl::string_view request) {
  std::sort(lanes.begin(), lanes.end());
  const auto twice = std::adjacent_find(lanes.begin(), lanes.end());
  if (twice == lanes.end()) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrFormat("lane %d is named twice in one %s", *twice, request));
}

int64_t MoreObjects(const Game& game) {
  return std::max<int64_t>(static_cast<int64_t>(game.world().object_room()) - kUsualObjects, 0);
}

}  // namespace

absl::Status EnvBatch::Open(absl::Span<const OpenLane> lanes, std::string* frames) {
  std::vector<int> numbers;
  numbers.reserve(lanes.size());
  for (const OpenLane& lane : lanes) numbers.push_back(lane.lane);
  CRAFTFLEET_RETURN_IF_ERROR(CheckDistinct(std::move(numbers), "open"));
  CRAFTFLEET_RETURN_IF_ERROR(CheckRoom(CountClosed(lanes)));
  Begin(lanes.size());
  refused_.clear();
  to_open_ = lanes;
  opened_frames_ = frames;
  frames->clear();
  if (format_ != FrameFormat::kScene) frames->resize(lanes.size() * renderer_->frame_bytes());
  return Resume();
}

void EnvBatch::Begin(size_t count) {
  count_ = count;
  next_ = 0;
  to_open_ = {};
  moments_.clear();
}

absl::Status EnvBatch::Resume() {
  const bool opening = !to_open_.empty();
  while (unfinished()) {
    CRAFTFLEET_RETURN_IF_ERROR(opening ? OpenNext() : StepNext());
    ++next_;
    if (paused_ != nullptr && unfinished() && paused_()) return absl::OkStatus();
  }
  if (opening && format_ != FrameFormat::kScene) {
    opened_frames_->resize((count_ - refused_.size()) * renderer_->frame_bytes());
  }
  picture_ = {};
  return absl::OkStatus();
}

absl::Status EnvBatch::OpenNext() {
  CRAFTFLEET_RETURN_IF_ERROR(CheckStopped());
  const OpenLane& lane = to_open_[next_];
  const bool scenes = format_ == FrameFormat::kScene;
  if (scenes) picture_.resize(renderer_->frame_bytes());
  const absl::Status status =
      OpenOne(lane, scenes ? Row(&picture_, 0, renderer_->frame_bytes())
                           : Row(opened_frames_, next_ - refused_.size(), renderer_->frame_bytes()));
  if (absl::IsDataLoss(status)) {
    Drop(lane.lane);
    refused_.push_back({lane.lane, std::string(status.message())});
    return absl::OkStatus();
  }
  if (status.ok() && scenes) games_.at(lane.lane).Record(opened_frames_);
  return status;
}

int64_t EnvBatch::CountClosed(absl::Span<const OpenLane> lanes) const {
  return std::count_if(lanes.begin(), lanes.end(), [this](const OpenLane& lane) { return !IsOpen(lane.lane); });
}

absl::Status EnvBatch::CheckRoom(int64_t more) const {
  int64_t most = kMaxLanes;
  if (records_) most = std::min(most, kMaxMomentBytes / (picture_bytes() + renderer_->frame_bytes()));
  if (more + size() <= most) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrFormat("%d lanes more on top of %d open ones, want at most %d in a %s", more, games_.size(), most,
                      records_ ? "session that records pictures of this size" : "session"));
}

absl::Status EnvBatch::CheckStopped() {
  if (stopped_ == nullptr) return absl::OkStatus();
  const absl::Time now = SteadyNow();
  if (now < next_check_) return absl::OkStatus();
  next_check_ = now + kCheckEvery;
  return stopped_() ? absl::CancelledError("the client left, or the server is stopping") : absl::OkStatus();
}

absl::Status EnvBatch::OpenOne(const OpenLane& lane, absl::Span<uint8_t> frame) {
  if (lane.lane < 0) return absl::InvalidArgumentError(absl::StrFormat("lane %d, want at least 0", lane.lane));
  const int64_t episode = lane.snapshot.empty() ? lane.episode : 1;
  if (episode < 1 || episode > kMaxEpisode) {
    return absl::InvalidArgumentError(
        absl::StrFormat("lane %d: episode %d, want 1..%d", lane.lane, episode, kMaxEpisode));
  }
  CRAFTFLEET_ASSIGN_OR_RETURN(Game game, Game::Create(renderer_, lane.seed, frame, episode));
  if (!lane.snapshot.empty()) {
    if (absl::Status status = game.Restore(lane.snapshot, frame); !status.ok()) {
      return absl::DataLossError(status.message());
    }
  }
  if (records_) moments_.push_back(game.TakeMoment(frame, larger_.get()));
  Drop(lane.lane);
  more_objects_ += MoreObjects(game);
  games_.emplace(lane.lane, std::move(game));
  return absl::OkStatus();
}

absl::Status EnvBatch::Step(absl::Span<const int> lanes, absl::Span<const Action> actions, bool snapshot,
                            StepBatch* batch) {
  CRAFTFLEET_RETURN_IF_ERROR(Find(lanes));
  Begin(lanes.size());
  actions_ = actions;
  snapshot_ = snapshot;
  step_ = batch;
  batch->frames.resize(format_ == FrameFormat::kScene ? 0 : lanes.size() * renderer_->frame_bytes());
  batch->last_frames.clear();
  batch->rewards.resize(lanes.size());
  batch->ends.resize(lanes.size());
  batch->episodes.clear();
  batch->snapshots.clear();
  return Resume();
}

absl::Status EnvBatch::StepNext() {
  const size_t row = next_;
  if (row % kGamesPerCheck == kGamesPerCheck - 1) CRAFTFLEET_RETURN_IF_ERROR(CheckStopped());
  Game* game = chosen_[row];
  more_objects_ -= MoreObjects(*game);
  const Game::PlayedStep played =
      format_ == FrameFormat::kScene
          ? game->StepAndRecord(actions_[row], snapshot_, &step_->frames, &step_->last_frames)
          : StepAndDraw(actions_[row], game, Row(&step_->frames, row, renderer_->frame_bytes()), step_);
  more_objects_ += MoreObjects(*game);
  step_->rewards[row] = static_cast<float>(played.outcome.reward);
  step_->ends[row] = played.outcome.end;
  if (played.episode.has_value()) step_->episodes.push_back(*played.episode);
  if (snapshot_) step_->snapshots.push_back(game->Save());
  return absl::OkStatus();
}

Game::PlayedStep EnvBatch::StepAndDraw(Action action, Game* game, absl::Span<uint8_t> frame, StepBatch* batch) {
  std::function<void()> record;
  if (records_) record = [&] { moments_.push_back(game->TakeMoment(frame, larger_.get())); };
  return game->StepAndAutoReset(action, frame, &batch->last_frames, record);
}

void EnvBatch::Close(absl::Span<const int> lanes) {
  for (const int lane : lanes) Drop(lane);
}

void EnvBatch::Drop(int lane) {
  const auto game = games_.find(lane);
  if (game == games_.end()) return;
  more_objects_ -= MoreObjects(game->second);
  games_.erase(game);
}

absl::Status EnvBatch::Find(absl::Span<const int> lanes) {
  chosen_.clear();
  for (const int lane : lanes) {
    const auto game = games_.find(lane);
    if (game == games_.end()) {
      return absl::InvalidArgumentError(absl::StrFormat(
          "lane %d is not open in this session, which has %d lanes: open it first", lane, games_.size()));
    }
    chosen_.push_back(&game->second);
  }
  return CheckDistinct(std::vector<int>(lanes.begin(), lanes.end()), "step");
}

}  // namespace craftfleet
