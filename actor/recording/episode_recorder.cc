#include "actor/recording/episode_recorder.h"

#include <algorithm>
#include <utility>
#include <vector>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>

#include "actor/recording/npz.h"
#include "actor/recording/picture.h"
#include "common/base/status_macros.h"
#include "common/io/files.h"

namespace craftfleet {
namespace {

absl::StatusOr<AttentionLight> LightOf(const EpisodeRecorder::AttentionSource& source,
                                       const EpisodeRecorder::Options& options, absl::string_view frame) {
  CRAFTFLEET_ASSIGN_OR_RETURN(const AttentionMap map, source(frame));
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::vector<float> weights, Choose(map, *options.attention));
  return LightToHighest(map.patches, weights);
}

}  // namespace

absl::StatusOr<std::unique_ptr<EpisodeRecorder>> EpisodeRecorder::Create(const Options& options,
                                                                         AttentionSource attention, absl::Time start) {
  if (options.attention.has_value()) {
    const std::string black(size_t{3} * options.frame_size * options.frame_size, '\0');
    CRAFTFLEET_RETURN_IF_ERROR(LightOf(attention, options, black).status());
  }
  for (const std::string& folder : {options.video_folder, options.npz_folder, options.picture_folder}) {
    if (!folder.empty()) CRAFTFLEET_RETURN_IF_ERROR(CreateFolders(folder));
  }
  return std::unique_ptr<EpisodeRecorder>(new EpisodeRecorder(options, std::move(attention), start));
}

absl::Status EpisodeRecorder::OnStart(int64_t number, const Moment& moment) {
  Recording recording;
  if (!options_.video_folder.empty()) {
    const std::string path = JoinPath(options_.video_folder, absl::StrCat("episode ", number));
    CRAFTFLEET_ASSIGN_OR_RETURN(recording.video, VideoFile::Create(path, picture_width(), picture_height()));
  }
  if (!options_.npz_folder.empty()) recording.table.emplace(options_.frame_size, moment);
  CRAFTFLEET_RETURN_IF_ERROR(AddPicture(number, moment, &recording));
  recordings_.insert_or_assign(number, std::move(recording));
  return absl::OkStatus();
}

absl::Status EpisodeRecorder::OnStep(int64_t number, const ObservedStep& step, const Moment& moment) {
  Recording& recording = recordings_.at(number);
  ++recording.steps;
  recording.unlocked = CountUnlocked(moment.achievements);
  if (recording.table.has_value()) recording.table->Add(step, moment);
  CRAFTFLEET_RETURN_IF_ERROR(AddPicture(number, moment, &recording));
  if (step.end == StepEnd::kNone) return absl::OkStatus();
  return Finish(number);
}

absl::Status EpisodeRecorder::FinishAll() {
  while (!recordings_.empty()) CRAFTFLEET_RETURN_IF_ERROR(Finish(recordings_.begin()->first));
  return absl::OkStatus();
}

absl::StatusOr<std::string> EpisodeRecorder::Show(const Moment& moment) const {
  if (!options_.attention.has_value()) return moment.picture;
  CRAFTFLEET_ASSIGN_OR_RETURN(const AttentionLight light, LightOf(attention_, options_, moment.frame));
  const int size = options_.picture_size;
  const std::string overlay = OverlayAttention(moment.picture, size, light.brightness, options_.frame_size);
  return BesideOverlay(moment.picture, overlay, size, light);
}

absl::Status EpisodeRecorder::AddPicture(int64_t number, const Moment& moment, Recording* recording) {
  const bool still = !options_.picture_folder.empty() && recording->steps % options_.picture_every == 0;
  if (!still && recording->video == nullptr) return absl::OkStatus();
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string picture, Show(moment));
  if (still) {
    const std::string name = absl::StrFormat("episode-%04d-step-%05d.png", number, recording->steps);
    CRAFTFLEET_RETURN_IF_ERROR(
        WritePng(JoinPath(options_.picture_folder, name), picture, picture_width(), picture_height()));
  }
  return recording->video == nullptr ? absl::OkStatus() : recording->video->Append(picture);
}

absl::Status EpisodeRecorder::Finish(int64_t number) {
  const Recording recording = std::move(recordings_.at(number));
  recordings_.erase(number);  // first: an error must not make FinishAll write it again
  const std::string stem = Stem(number, recording);
  if (recording.table.has_value()) {
    const std::string path = JoinPath(options_.npz_folder, absl::StrCat(stem, ".npz"));
    CRAFTFLEET_RETURN_IF_ERROR(WriteNpz(path, recording.table->Arrays()));
  }
  if (recording.video == nullptr) return absl::OkStatus();
  return recording.video->Finish(JoinPath(options_.video_folder, absl::StrCat(stem, ".mp4")));
}

std::string EpisodeRecorder::Stem(int64_t number, const Recording& recording) const {
  const auto taken = [](const std::string& folder, const std::string& name) {
    return !folder.empty() && PathExists(JoinPath(folder, name));
  };
  for (absl::Time time = start_ + absl::Seconds(number - options_.first_episode);; time += absl::Seconds(1)) {
    std::string stem =
        absl::StrFormat("%s-episode%04d-ach%d-len%d", absl::FormatTime("%Y%m%dT%H%M%S", time, absl::UTCTimeZone()),
                        number, recording.unlocked, recording.steps);
    if (!taken(options_.npz_folder, stem + ".npz") && !taken(options_.video_folder, stem + ".mp4")) return stem;
  }
}

}  // namespace craftfleet
