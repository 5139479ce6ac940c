// Where an agent looks in a frame, and what of it is shown. No LibTorch here.

#ifndef CRAFTFLEET_COMMON_AGENT_ATTENTION_MAP_H_
#define CRAFTFLEET_COMMON_AGENT_ATTENTION_MAP_H_

#include <string>
#include <vector>

#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>
#include <absl/types/span.h>

namespace craftfleet {

// Squares that a frame is cut into, row by row; what is left over at the right and the bottom belongs to none.
struct PatchGrid {
  int frame_size = 0;  // pixels, width and height; at least `patch`
  int patch = 1;       // pixels, width and height of a square
  int stride = 1;      // pixels from one square to the next; below `patch` they overlap

  int per_side() const { return (frame_size - patch) / stride + 1; }
  int count() const { return per_side() * per_side(); }
};

// Source: "The agents", section 7.
struct AttentionMap {
  PatchGrid patches;
  int views = 0;               // OC-SA: heads of the CLS token, in the last layer; OC-CA: slots, mean over heads
  std::vector<float> weights;  // [views,patches.count()], a view's sum at most 1: OC-CA's are 1
};

// Which of a map's views are shown.
struct AttentionChoice {
  enum class Kind { kMean, kSum, kOne };
  Kind kind = Kind::kMean;
  int view = 0;  // of kOne, from 0

  // "mean", "sum" or a view's number.   InvalidArgument: another text.
  static absl::StatusOr<AttentionChoice> Parse(absl::string_view text);
};

// float[patches]: mean or sum over the views, or one.
//   InvalidArgument: the map has no such view; says how many there are.
absl::StatusOr<std::vector<float>> Choose(const AttentionMap& map, const AttentionChoice& choice);

// float[H,W] of the frame: each pixel has the mean of the patches that it belongs to, 0 without any.
// `weights` is float[grid.count()].
std::vector<float> SpreadOverPixels(const PatchGrid& grid, absl::Span<const float> weights);

// The same for display, 0..1: times the square root of the number of patches, at most 1.
std::vector<float> BrightnessOfPixels(const PatchGrid& grid, absl::Span<const float> weights);

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_AGENT_ATTENTION_MAP_H_
