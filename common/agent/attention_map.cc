#include "common/agent/attention_map.h"

#include <algorithm>
#include <cmath>

#include <absl/status/status.h>
#include <absl/strings/numbers.h>
#include <absl/strings/str_cat.h>

#include "common/base/check.h"

namespace craftfleet {

absl::StatusOr<AttentionChoice> AttentionChoice::Parse(absl::string_view text) {
  AttentionChoice choice;
  if (text == "mean") return choice;
  choice.kind = Kind::kSum;
  if (text == "sum") return choice;
  choice.kind = Kind::kOne;
  if (absl::SimpleAtoi(text, &choice.view) && choice.view >= 0) return choice;
  return absl::InvalidArgumentError(
      absl::StrCat("attention \"", text, "\", want mean, sum or the number of one head or slot, from 0"));
}

absl::StatusOr<std::vector<float>> Choose(const AttentionMap& map, const AttentionChoice& choice) {
  const int patches = map.patches.count();
  CRAFTFLEET_CHECK(map.views > 0 && map.weights.size() == static_cast<size_t>(map.views) * patches);
  if (choice.kind == AttentionChoice::Kind::kOne) {
    if (choice.view >= map.views) {
      return absl::InvalidArgumentError(
          absl::StrCat("attention ", choice.view, ": the agent has heads or slots 0..", map.views - 1));
    }
    const auto begin = map.weights.begin() + choice.view * patches;
    return std::vector<float>(begin, begin + patches);
  }
  const float scale = choice.kind == AttentionChoice::Kind::kMean ? 1.0F / static_cast<float>(map.views) : 1.0F;
  std::vector<float> chosen(patches);
  for (size_t i = 0; i < map.weights.size(); ++i) chosen[i % patches] += map.weights[i] * scale;
  return chosen;
}

std::vector<float> SpreadOverPixels(const PatchGrid& grid, absl::Span<const float> weights) {
  CRAFTFLEET_CHECK(static_cast<int>(weights.size()) == grid.count());
  std::vector<float> sums(grid.frame_size * grid.frame_size);
  std::vector<int> covers(sums.size());
  for (int i = 0; i < grid.count(); ++i) {
    const int top = i / grid.per_side() * grid.stride;
    const int left = i % grid.per_side() * grid.stride;
    for (int y = top; y < top + grid.patch; ++y) {
      for (int x = left; x < left + grid.patch; ++x) {
        sums[y * grid.frame_size + x] += weights[i];
        ++covers[y * grid.frame_size + x];
      }
    }
  }
  for (size_t i = 0; i < sums.size(); ++i) sums[i] /= static_cast<float>(std::max(covers[i], 1));
  return sums;
}

float LightToHighest(std::vector<float>* weights) {
  const float highest = *std::max_element(weights->begin(), weights->end());
  if (highest <= 0) return highest;
  for (float& weight : *weights) weight = std::sqrt(std::max(weight, 0.0F) / highest);
  return highest;
}

}  // namespace craftfleet
