// Suggestions for mistyped names: "did you mean --lanes?"

#pragma once

#include <string>
#include <vector>

#include <absl/strings/string_view.h>

namespace craftfleet {

// The closest of `names`: the one with the fewest insertions, deletions, replacements and swaps of adjacent letters, at
// most a third of its length; the first of several. Empty: none is close.
std::string ClosestName(absl::string_view name, const std::vector<std::string>& names);

// " (did you mean "lanes"?)" with that name; "": none is close.
std::string DidYouMean(absl::string_view name, const std::vector<std::string>& names);

}  // namespace craftfleet
