#include "common/process/closest_name.h"

#include <algorithm>
#include <cstddef>
#include <utility>

#include <absl/strings/str_cat.h>

namespace craftfleet {
namespace {

// The Damerau-Levenshtein distance, with each letter edited at most once (optimal string alignment).
size_t EditDistance(absl::string_view a, absl::string_view b) {
  std::vector<size_t> before;
  std::vector<size_t> previous(b.size() + 1);
  for (size_t j = 0; j <= b.size(); ++j) previous[j] = j;
  for (size_t i = 1; i <= a.size(); ++i) {
    std::vector<size_t> row(b.size() + 1, i);
    for (size_t j = 1; j <= b.size(); ++j) {
      const size_t replaced = previous[j - 1] + (a[i - 1] == b[j - 1] ? 0 : 1);
      row[j] = std::min({previous[j] + 1, row[j - 1] + 1, replaced});
      const bool swapped = i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1];
      if (swapped) row[j] = std::min(row[j], before[j - 2] + 1);
    }
    before = std::move(previous);
    previous = std::move(row);
  }
  return previous[b.size()];
}

}  // namespace

std::string ClosestName(absl::string_view name, const std::vector<std::string>& names) {
  constexpr size_t kLongest = 100;  // longer input is not a mistyped name, and slow to compare
  if (name.size() > kLongest) return "";
  std::string closest;
  size_t least = std::max<size_t>(1, (name.size() + 1) / 3) + 1;
  for (const std::string& candidate : names) {
    const size_t distance = EditDistance(name, candidate);
    if (distance >= least) continue;
    least = distance;
    closest = candidate;
  }
  return closest;
}

std::string DidYouMean(absl::string_view name, const std::vector<std::string>& names) {
  const std::string closest = ClosestName(name, names);
  return closest.empty() ? "" : absl::StrCat(" (did you mean \"", closest, "\"?)");
}

}  // namespace craftfleet
