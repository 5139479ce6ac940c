#include "deploy/cli/watch/attention_strip.h"

#include <algorithm>
#include <set>
#include <utility>

#include <absl/strings/str_cat.h>
#include <opencv2/imgproc.hpp>

#include "common/base/check.h"
#include "common/base/status_macros.h"

namespace craftfleet {
namespace {

absl::Status Stopped() { return absl::CancelledError("stopped before the strip was complete"); }

void Paste(const std::string& picture, int x, int y, cv::Mat* canvas) {
  const cv::Mat pixels(kStripPicture, kStripPicture, CV_8UC3, const_cast<char*>(picture.data()));
  pixels.copyTo((*canvas)(cv::Rect(x, y, kStripPicture, kStripPicture)));
}

}  // namespace

StripPicture DrawStrip(const std::vector<StripColumn>& columns) {
  CRAFTFLEET_CHECK(!columns.empty());
  const int count = static_cast<int>(columns.size());
  cv::Mat canvas(2 * kStripPicture + 3 * kStripGap + kStripLabel, count * (kStripPicture + kStripGap) + kStripGap,
                 CV_8UC3, cv::Scalar::all(255));
  int x = kStripGap;
  for (const StripColumn& column : columns) {
    const AttentionLight light = LightToHighest(column.patches, column.weights);
    Paste(column.picture, x, kStripGap, &canvas);
    Paste(OverlayAttention(column.picture, kStripPicture, light.brightness, column.patches.frame_size), x,
          2 * kStripGap + kStripPicture, &canvas);
    cv::putText(canvas, absl::StrCat("step ", column.step), {x, canvas.rows - kStripGap - 2}, cv::FONT_HERSHEY_SIMPLEX,
                0.5, cv::Scalar::all(40), 1, cv::LINE_AA);
    x += kStripPicture + kStripGap;
  }
  return {canvas.cols, canvas.rows,
          std::string(reinterpret_cast<const char*>(canvas.data), size_t{3} * canvas.rows * canvas.cols)};
}

std::vector<int64_t> ChooseSteps(const std::vector<int64_t>& unlocks, int64_t length, int count) {
  std::set<int64_t> steps;
  for (const int64_t step : unlocks) {
    if (static_cast<int>(steps.size()) < count) steps.insert(step);
  }
  // Fills up with evenly spread steps, in ever smaller gaps until there are enough of them.
  const auto wanted = static_cast<size_t>(std::min<int64_t>(count, length));
  for (int64_t parts = count; steps.size() < wanted; parts *= 2) {
    for (int64_t i = 0; i < parts && steps.size() < wanted; ++i) steps.insert(i * length / parts);
  }
  return {steps.begin(), steps.end()};
}

absl::StatusOr<EpisodeOutline> PlayOutline(const std::atomic<bool>& stop, const StepListener& on_step,
                                           AgentGame* game) {
  EpisodeOutline outline;
  while (!game->ended()) {
    if (stop) return Stopped();
    CRAFTFLEET_RETURN_IF_ERROR(game->Step());
    on_step(game->world().step());
    if (game->outcome().unlocked != 0) outline.unlocks.push_back(game->world().step() - 1);
  }
  outline.length = game->world().step();
  return outline;
}

absl::StatusOr<std::vector<StripColumn>> TakeColumns(const std::vector<int64_t>& steps, const AttentionChoice& choice,
                                                     const std::atomic<bool>& stop, const StepListener& on_step,
                                                     AgentGame* game) {
  std::vector<StripColumn> columns;
  for (const int64_t step : steps) {
    while (game->world().step() < step && !game->ended()) {
      if (stop) return Stopped();
      CRAFTFLEET_RETURN_IF_ERROR(game->Step());
      on_step(game->world().step());
    }
    if (game->ended()) break;
    StripColumn column;
    column.step = step;
    CRAFTFLEET_ASSIGN_OR_RETURN(column.picture, game->Picture(kStripPicture));
    CRAFTFLEET_ASSIGN_OR_RETURN(const AttentionMap map, game->Attention());
    column.patches = map.patches;
    CRAFTFLEET_ASSIGN_OR_RETURN(column.weights, Choose(map, choice));
    columns.push_back(std::move(column));
  }
  return columns;
}

}  // namespace craftfleet
