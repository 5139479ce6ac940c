// stats.jsonl: an episode must not change when it is written and read again, except that the reward is rounded as by
// Crafter's recorder; writing it once more must give the same line.

#include <absl/strings/str_split.h>
#include <absl/strings/strip.h>

#include "common/base/check.h"
#include "learner/run/stats_log.h"
#include "tests/fuzz/fuzz_target.h"

namespace craftfleet {
namespace {

void TryLine(absl::string_view line) {
  const auto read = ParseStatsLine(line);
  if (!read.ok()) return;
  const std::string text = FormatStatsLine(*read);
  const auto again = ParseStatsLine(absl::StripSuffix(text, "\n"));
  CRAFTFLEET_CHECK(again.ok());
  CRAFTFLEET_CHECK(again->length == read->length);
  CRAFTFLEET_CHECK(again->achievements == read->achievements);
  CRAFTFLEET_CHECK(again->reward == RoundReward(read->reward));
  CRAFTFLEET_CHECK(FormatStatsLine(*again) == text);
}

}  // namespace

void TryInput(absl::string_view input) {
  for (const absl::string_view line : absl::StrSplit(input, '\n')) TryLine(line);
}

std::vector<std::string> SoundInputs() {
  Episode episode;
  episode.length = 163;
  episode.reward = 1.1;
  for (int i = 0; i < kNumAchievements; ++i) episode.achievements[i] = i * i;  // all different
  Episode other;
  other.length = 10000;
  other.reward = -0.9;
  Episode unrounded;
  unrounded.length = 2;
  unrounded.reward = 0.25;
  return {FormatStatsLine(episode) + FormatStatsLine(other), FormatStatsLine(other), FormatStatsLine(unrounded), ""};
}

}  // namespace craftfleet
