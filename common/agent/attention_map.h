// The attention of an agent to the patches of a frame, and how it is shown. Does not include LibTorch.

#pragma once

#include <string>
#include <vector>

#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>
#include <absl/types/span.h>

namespace craftfleet {

// The square patches of a frame, row by row; pixels left over at the right and the bottom are in no patch.
struct PatchGrid {
  int frame_size = 0;  // pixels, width and height; at least `patch`
  int patch = 1;       // pixels, width and height of a square
  int stride = 1;      // pixels from one square to the next; below `patch` they overlap

  int per_side() const { return (frame_size - patch) / stride + 1; }
  int count() const { return per_side() * per_side(); }
};

// Source: AGENTS.md, section 11.
struct AttentionMap {
  PatchGrid patches;
  int views = 0;               // OC-SA: heads of the CLS token, in the last layer; OC-CA: slots, mean over heads
  std::vector<float> weights;  // [views,patches.count()], a view's sum at most 1: OC-CA's are 1
};

// Selects the views of a map to show.
struct AttentionChoice {
  enum class Kind { kMean, kSum, kOne };
  Kind kind = Kind::kMean;
  int view = 0;  // of kOne, from 0

  // "mean", "sum" or a view's number.   InvalidArgument: another text.
  static absl::StatusOr<AttentionChoice> Parse(absl::string_view text);
};

// float[patches]: mean or sum over the views, or one.
//   InvalidArgument: the map has no such view; names the number of views.
absl::StatusOr<std::vector<float>> Choose(const AttentionMap& map, const AttentionChoice& choice);

// float[H,W] of the frame: each pixel gets the mean of the patches that contain it, 0 if there are none.
// `weights` is float[grid.count()].
std::vector<float> SpreadOverPixels(const PatchGrid& grid, absl::Span<const float> weights);

// Turns weights into brightness up to the highest of them: the square root of their share of it, so that small weights
// are visible; 0 for negative ones, and unchanged if none is positive. Not empty. Returns the highest weight.
float LightToHighest(std::vector<float>* weights);

}  // namespace craftfleet
