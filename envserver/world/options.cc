#include "envserver/world/options.h"

#include <numeric>

#include <absl/strings/match.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_join.h>
#include <absl/strings/string_view.h>

#include "common/base/status_macros.h"

namespace craftfleet {
namespace {

constexpr absl::string_view kPaperLetters = "tczsuk";

template <typename T>
absl::Status CheckRange(absl::string_view name, T value, T low, T high) {
  if (value >= low && value <= high) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrCat(name, " ", value, ", want ", low, "..", high));
}

// The table of RULES.md, section 14.
NumberThresholds ThresholdsOf(absl::string_view letters) {
  constexpr absl::string_view kRows = "qhsdf";
  constexpr double kTree[] = {.945, .9, .8, .6, .2};
  constexpr double kCoal[] = {.963, .92, .85, .7, .4};
  constexpr double kCow[] = {.9968, .993, .985, .97, .91};
  constexpr double kZombie[] = {.998, .9968, .993, .985, .96};
  constexpr double kSkeleton[] = {.99, .977, .95, .9, .8};
  const auto row = [&](int thing) { return kRows.find(letters[thing]); };
  return {kTree[row(0)], kCoal[row(1)], kCow[row(2)], kZombie[row(3)], kSkeleton[row(4)]};
}

}  // namespace

WorldOptions WorldOptions::FromEnvName(const EnvName& name) {
  WorldOptions options;
  if (name.appearance) options.appearance = absl::StrCat(kPaperLetters);
  options.percentages = name.percentages;
  options.numbers = ThresholdsOf(name.numbers);
  options.name = name.WorldName();
  return options;
}

absl::Status WorldOptions::Validate() const {
  CRAFTFLEET_RETURN_IF_ERROR(CheckRange("width", width, 4, 250));
  CRAFTFLEET_RETURN_IF_ERROR(CheckRange("height", height, 4, 250));
  CRAFTFLEET_RETURN_IF_ERROR(CheckRange("view_width", view_width, 1, 63));
  CRAFTFLEET_RETURN_IF_ERROR(CheckRange("view_height", view_height, inventory_rows() + 1, 63));
  CRAFTFLEET_RETURN_IF_ERROR(CheckRange("length", length, 0, 1'000'000'000));
  CRAFTFLEET_RETURN_IF_ERROR(CheckRange("tree threshold", numbers.tree, 0.0, 1.0));
  CRAFTFLEET_RETURN_IF_ERROR(CheckRange("coal threshold", numbers.coal, 0.0, 1.0));
  CRAFTFLEET_RETURN_IF_ERROR(CheckRange("cow threshold", numbers.cow, 0.0, 1.0));
  CRAFTFLEET_RETURN_IF_ERROR(CheckRange("zombie threshold", numbers.zombie, 0.0, 1.0));
  CRAFTFLEET_RETURN_IF_ERROR(CheckRange("skeleton threshold", numbers.skeleton, 0.0, 1.0));
  for (const int percentage : percentages) CRAFTFLEET_RETURN_IF_ERROR(CheckRange("percentage", percentage, 0, 100));
  if (std::accumulate(percentages.begin(), percentages.end(), 0) != 100) {
    return absl::InvalidArgumentError(absl::StrCat("percentages ", absl::StrJoin(percentages, "/"), ", want sum 100"));
  }
  for (size_t i = 0; i < appearance.size(); ++i) {
    const char letter = appearance[i];
    if (!absl::StrContains(kAppearanceLetters, letter) || appearance.find(letter, i + 1) != std::string::npos) {
      return absl::InvalidArgumentError(absl::StrCat("appearance \"", appearance, "\", want letters of \"",
                                                     kAppearanceLetters, "\", each at most once"));
    }
    if (absl::StrContains(kLettersWithOneVariant, letter) && percentages[0] != 100) {
      return absl::InvalidArgumentError(absl::StrCat("appearance \"", appearance, "\" with percentages ",
                                                     absl::StrJoin(percentages, "/"), ": '", std::string(1, letter),
                                                     "' has one variant only, want 100/0/0/0"));
    }
  }
  return absl::OkStatus();
}

}  // namespace craftfleet
