// stats.jsonl: an episode must not change when it is written and read again, except that the reward is rounded as by
// Crafter's recorder; writing it once more must give the same line.

#include "common/base/check.h"
#include "learner/run/stats_log.h"
#include "tests/fuzz/fuzz_target.h"

namespace craftfleet {
namespace {

std::string Format(const std::vector<Episode>& episodes) {
  std::string text;
  for (const Episode& episode : episodes) text += FormatStatsLine(episode);
  return text;
}

}  // namespace

void TryInput(absl::string_view input) {
  const auto episodes = ParseStats(input, "input");
  if (!episodes.ok()) return;
  const std::string text = Format(*episodes);
  const auto again = ParseStats(text, "again");
  CRAFTFLEET_CHECK(again.ok() && again->size() == episodes->size());
  for (size_t i = 0; i < episodes->size(); ++i) {
    const Episode& read = (*episodes)[i];
    const Episode& reread = (*again)[i];
    CRAFTFLEET_CHECK(reread.length == read.length);
    CRAFTFLEET_CHECK(reread.achievements == read.achievements);
    CRAFTFLEET_CHECK(reread.reward == RoundReward(read.reward));
  }
  CRAFTFLEET_CHECK(Format(*again) == text);
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
