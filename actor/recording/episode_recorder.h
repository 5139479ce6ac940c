// Records the episodes of an evaluation as videos, pictures and NumPy files.

#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>
#include <absl/time/time.h>

#include "actor/episode_observer.h"
#include "actor/recording/picture.h"
#include "actor/recording/video_file.h"
#include "common/agent/attention_map.h"
#include "common/base/types.h"

namespace craftfleet {

// An episode's files are named "<YYYYMMDDThhmmss>-episode<number>-ach<unlocked>-len<steps>", its video .mp4, its table
// .npz. The time is the start of the recording (UTC) plus a second for each earlier episode, so that files sort by
// episode, like those of Crafter's own recorder. Existing files are kept: if a name is taken, a later time is used. A
// video is written while its episode is played; a table is kept in memory until then (17 KB a step).
class EpisodeRecorder : public EpisodeObserver {
 public:
  // As Policy::Attention; not the policy itself, which needs LibTorch.
  using AttentionSource = std::function<absl::StatusOr<AttentionMap>(absl::string_view frame)>;

  struct Options {
    std::string video_folder;    // empty: no videos
    std::string npz_folder;      // empty: no tables
    std::string picture_folder;  // empty: no pictures
    int picture_every = 50;      // steps from one picture of an episode to the next, the first at its reset
    int frame_size = 64;         // pixels, width and height of the moments' frames
    int picture_size = 0;        // of the moments' pictures, even; needed for videos and pictures
    std::optional<AttentionChoice> attention;  // set: videos and pictures also show the agent's attention, on the right
    int64_t first_episode = 1;                 // lowest episode number to record
  };

  // Creates the folders. `attention` is called only if the options choose one.
  //   InvalidArgument: the policy does not have the chosen attention.   Others: codes of common/io/files.h.
  static absl::StatusOr<std::unique_ptr<EpisodeRecorder>> Create(const Options& options, AttentionSource attention,
                                                                 absl::Time start);
  ~EpisodeRecorder() override;

  absl::Status OnStart(int64_t number, const Moment& moment) override;
  absl::Status OnStep(int64_t number, const ObservedStep& step, const Moment& moment) override;

  // Keeps what has been recorded of unfinished episodes, as if they had ended here.
  absl::Status FinishAll();

 private:
  class Table;
  struct Recording {
    int64_t steps = 0;
    int unlocked = 0;                  // achievements
    std::unique_ptr<VideoFile> video;  // null: none
    std::unique_ptr<Table> table;      // null: none
  };

  EpisodeRecorder(const Options& options, AttentionSource attention, absl::Time start);

  int picture_width() const { return options_.picture_size * (options_.attention.has_value() ? 2 : 1); }
  int picture_height() const {
    return options_.picture_size + (options_.attention.has_value() ? ScaleHeight(options_.picture_size) : 0);
  }
  // The picture of a moment in videos and files: uint8[picture_height(),picture_width(),3].
  absl::StatusOr<std::string> Show(const Moment& moment) const;
  // Adds the picture of episode `number` at `recording.steps` steps after its reset.
  absl::Status AddPicture(int64_t number, const Moment& moment, Recording* recording);
  // Ends the recording of episode `number`, which is gone also after an error.
  absl::Status Finish(int64_t number);
  // Chooses the name of the episode's files, without extension, so that neither file exists yet.
  std::string Stem(int64_t number, const Recording& recording) const;

  const Options options_;
  const AttentionSource attention_;
  const absl::Time start_;
  std::map<int64_t, Recording> recordings_;  // of unfinished episodes, by number
};

}  // namespace craftfleet
