#include "deploy/cli/watch/watch_video.h"

#include <memory>

#include <opencv2/imgproc.hpp>

#include "actor/recording/video_file.h"
#include "common/base/status_macros.h"
#include "deploy/cli/screen/view_picture.h"
#include "deploy/cli/watch/watch_view.h"

namespace craftfleet {
namespace {

absl::StatusOr<cv::Mat> DrawPicture(const WatchVideoOptions& options, AgentGame* game) {
  const PictureRoom room = {options.size, options.size};
  CRAFTFLEET_ASSIGN_OR_RETURN(const View view, DrawMoment(options.title, room, options.attention, game));
  cv::Mat rgb;
  cv::cvtColor(DrawView(view, room), rgb, cv::COLOR_BGR2RGB);
  return rgb;
}

}  // namespace

absl::Status WriteWatchVideo(const WatchVideoOptions& options, const std::atomic<bool>& stop, AgentGame* game) {
  std::unique_ptr<VideoFile> video;
  while (true) {
    CRAFTFLEET_ASSIGN_OR_RETURN(const cv::Mat picture, DrawPicture(options, game));
    if (video == nullptr) {
      CRAFTFLEET_ASSIGN_OR_RETURN(video, VideoFile::Create(options.path, picture.cols, picture.rows));
    }
    CRAFTFLEET_RETURN_IF_ERROR(
        video->Append({reinterpret_cast<const char*>(picture.data), picture.total() * picture.elemSize()}));
    if (stop || game->ended()) return video->Finish(options.path);
    CRAFTFLEET_RETURN_IF_ERROR(game->Step());
    if (options.on_step) options.on_step(game->world().step());
  }
}

}  // namespace craftfleet
