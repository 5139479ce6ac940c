#include "deploy/cli/play/play_session.h"

#include <utility>

#include <absl/memory/memory.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>

#include "common/base/status_macros.h"

namespace craftfleet {
namespace {

constexpr int kFrameSize = 64;      // pixels, width and height of what an agent sees
constexpr int kRecordedSize = 576;  // pixels, width and height of videos

}  // namespace

absl::StatusOr<std::unique_ptr<PlaySession>> PlaySession::Create(const Options& options) {
  CRAFTFLEET_ASSIGN_OR_RETURN(const auto renderer,
                              SquareRenderer(*options.textures, options.env, kEpisodeLength, kFrameSize));
  std::string frame(renderer->frame_bytes(), '\0');
  CRAFTFLEET_ASSIGN_OR_RETURN(Game game, Game::Create(renderer, options.seed, FrameBytes(&frame), options.episode));
  auto session = absl::WrapUnique(new PlaySession(options, std::move(game), std::move(frame)));
  if (!options.record_folder.empty()) {
    EpisodeRecorder::Options recording;
    recording.video_folder = options.record_folder;
    recording.npz_folder = options.record_folder;
    recording.picture_size = kRecordedSize;
    recording.first_episode = options.episode;
    CRAFTFLEET_ASSIGN_OR_RETURN(session->recorder_, EpisodeRecorder::Create(recording, nullptr, options.start));
    CRAFTFLEET_RETURN_IF_ERROR(session->StartRecording());
  }
  return session;
}

absl::Status PlaySession::Step(Action action) {
  if (ended()) return absl::OkStatus();
  const StepOutcome outcome = game_.Step(action, FrameBytes(&frame_));
  end_ = outcome.end;
  events_.Add(world(), outcome);
  if (recorder_ == nullptr) return absl::OkStatus();
  CRAFTFLEET_ASSIGN_OR_RETURN(const Moment moment, Record());
  return recorder_->OnStep(world().episode(), {action, static_cast<float>(outcome.reward), outcome.end}, moment);
}

absl::Status PlaySession::StartNextEpisode() {
  if (recorder_ != nullptr) CRAFTFLEET_RETURN_IF_ERROR(recorder_->FinishAll());
  game_.Reset(FrameBytes(&frame_));
  end_ = StepEnd::kNone;
  events_.Clear();
  return recorder_ == nullptr ? absl::OkStatus() : StartRecording();
}

absl::Status PlaySession::Finish() { return recorder_ == nullptr ? absl::OkStatus() : recorder_->FinishAll(); }

absl::Status PlaySession::StartRecording() {
  CRAFTFLEET_ASSIGN_OR_RETURN(const Moment moment, Record());
  return recorder_->OnStart(world().episode(), moment);
}

absl::StatusOr<Moment> PlaySession::Record() { return recorded_.Take(game_, frame_, kRecordedSize); }

absl::StatusOr<std::string> PlaySession::Picture(int size) {
  CRAFTFLEET_ASSIGN_OR_RETURN(Moment moment, shown_.Take(game_, frame_, size));
  return std::move(moment.picture);
}

std::vector<TextLine> PlaySession::Panel() const {
  std::vector<TextLine> lines = {
      {options_.env.ToString(), TextLine::Style::kTitle},
      {absl::StrFormat("seed %d, episode %d", world().seed(), world().episode())},
      {absl::StrFormat("step %d, %s%s", world().step(), world().daylight() < 0.5 ? "night" : "day",
                       world().player().sleeping ? ", asleep" : "")},
      {absl::StrFormat("reward %.1f, %d of %d unlocked", world().episode_reward(),
                       CountUnlocked(world().player().achievements), kNumAchievements)},
      NeedsLine(world()),
  };
  if (ended()) lines.push_back({"n: next episode, q: quit", TextLine::Style::kTitle});  // here it is never cut off
  lines.push_back({""});
  for (TextLine& line : InventoryLines(world(), kTextColumns)) lines.push_back(std::move(line));
  lines.push_back({""});
  lines.insert(lines.end(), events_.lines().begin(), events_.lines().end());
  return lines;
}

std::string PlaySession::Summary() const {
  std::string names;
  for (int i = 0; i < kNumAchievements; ++i) {
    if (world().player().achievements[i] == 0) continue;
    absl::StrAppend(&names, names.empty() ? ": " : ", ", Words(kAchievementNames[i]));
  }
  return absl::StrFormat("%s, seed %d, episode %d: %d steps, reward %.1f, %d of %d achievements%s",
                         options_.env.ToString(), world().seed(), world().episode(), world().step(),
                         world().episode_reward(), CountUnlocked(world().player().achievements), kNumAchievements,
                         names);
}

}  // namespace craftfleet
