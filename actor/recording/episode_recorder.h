// Makes videos, pictures and numpy files of the episodes of an evaluation.

#ifndef CRAFTFLEET_ACTOR_RECORDING_EPISODE_RECORDER_H_
#define CRAFTFLEET_ACTOR_RECORDING_EPISODE_RECORDER_H_

#include <cstdint>
#include <map>
#include <memory>
#include <string>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/time/time.h>
#include <absl/types/optional.h>

#include "actor/episode_observer.h"
#include "actor/recording/episode_table.h"
#include "actor/recording/video_file.h"
#include "common/agent/attention_map.h"
#include "common/agent/policy.h"
#include "common/types.h"

namespace craftfleet {

// An episode's files are named "<YYYYMMDDThhmmss>-ach<unlocked>-len<steps>", its video .mp4, its table .npz. The time
// is that of the recording's start (UTC) and a second more for each episode before it, so that names are unique and
// sort as the episodes were numbered. A video is written while its episode is played; a table waits in memory (17 KB a
// step).
class EpisodeRecorder : public EpisodeObserver {
 public:
  struct Options {
    std::string video_folder;    // empty: no videos
    std::string npz_folder;      // empty: no tables
    std::string picture_folder;  // empty: no pictures
    int picture_every = 50;      // steps from one picture of an episode to the next, the first at its reset
    int frame_size = 64;         // pixels, width and height of the moments' frames
    int picture_size = 0;        // of the moments' pictures, even; needed for videos and pictures
    absl::optional<AttentionChoice> attention;  // videos and pictures also show where the agent looks, on the right
    int64_t first_episode = 1;                  // the lowest number to be recorded
  };

  // Makes the folders. `policy`, whose attention is shown, outlives the recorder.
  //   InvalidArgument: attention is asked for that the policy does not have.   Codes of common/files.h.
  static absl::StatusOr<std::unique_ptr<EpisodeRecorder>> Create(const Options& options, const Policy* policy,
                                                                 absl::Time start);

  absl::Status OnStart(int64_t number, const Moment& moment) override;
  absl::Status OnStep(int64_t number, const ObservedStep& step, const Moment& moment) override;

 private:
  struct Recording {
    int64_t steps = 0;
    std::unique_ptr<VideoFile> video;    // null: none
    absl::optional<EpisodeTable> table;  // none if it is not asked for
  };

  EpisodeRecorder(const Options& options, const Policy* policy, absl::Time start)
      : options_(options), policy_(policy), start_(start) {}

  int picture_width() const { return options_.picture_size * (options_.attention.has_value() ? 2 : 1); }
  // What videos and pictures show of a moment: uint8[picture_size,picture_width(),3].
  absl::StatusOr<std::string> Show(const Moment& moment) const;
  // A moment of the episode `number`, `recording.steps` after its reset.
  absl::Status AddPicture(int64_t number, const Moment& moment, Recording* recording);
  absl::Status Finish(int64_t number, const Moment& last, Recording* recording);
  // Without the files' endings; neither file is there yet.
  std::string Stem(int64_t number, const Moment& last, int64_t steps) const;

  const Options options_;
  const Policy* const policy_;
  const absl::Time start_;
  std::map<int64_t, Recording> recordings_;  // under way, by number
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_ACTOR_RECORDING_EPISODE_RECORDER_H_
