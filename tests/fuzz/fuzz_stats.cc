// stats.jsonl: what is read can be written, and reads the same then.

#include "common/check.h"
#include "learner/run/stats_log.h"
#include "tests/fuzz/fuzz_target.h"

namespace craftfleet {

void TryInput(absl::string_view input) {
  const auto episodes = ParseStats(input, "input");
  if (!episodes.ok()) return;
  std::string text;
  for (const Episode& episode : *episodes) text += FormatStatsLine(episode);
  const auto again = ParseStats(text, "again");
  CRAFTFLEET_CHECK(again.ok() && again->size() == episodes->size());
}

std::vector<std::string> SoundInputs() {
  Episode episode;
  episode.length = 163;
  episode.reward = 1.1;
  episode.achievements[3] = 2;
  Episode other;
  other.length = 10000;
  other.reward = -0.9;
  return {FormatStatsLine(episode) + FormatStatsLine(other), FormatStatsLine(other), ""};
}

}  // namespace craftfleet
