#include "learner/run/stats_log.h"

#include <cstdint>
#include <limits>

#include <absl/strings/numbers.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/strings/str_split.h>
#include <absl/strings/string_view.h>
#include <nlohmann/json.hpp>

#include "common/check.h"
#include "common/crafter.h"
#include "common/gzip_file.h"
#include "common/status_macros.h"

namespace craftfleet {
namespace {

constexpr size_t kKeys = 2 + kNumAchievements;

std::string FormatReward(double reward) { return absl::StrFormat("%.1f", reward); }

absl::StatusOr<int64_t> ReadInteger(const nlohmann::json& object, const std::string& key, int64_t low, int64_t high) {
  const auto found = object.find(key);
  if (found == object.end()) return absl::DataLossError(absl::StrCat("no \"", key, "\""));
  if (!found->is_number_integer() || *found < low || *found > high) {
    return absl::DataLossError(absl::StrCat("\"", key, "\" is ", found->dump(), ", want ", low, "..", high));
  }
  return found->get<int64_t>();
}

absl::StatusOr<Episode> ParseStatsLine(absl::string_view line) {
  const auto object = nlohmann::json::parse(line.begin(), line.end(), nullptr, /*allow_exceptions=*/false);
  if (!object.is_object()) return absl::DataLossError("not a JSON object");
  Episode episode;
  CRAFTFLEET_ASSIGN_OR_RETURN(episode.length, ReadInteger(object, "length", 1, std::numeric_limits<int64_t>::max()));
  const auto reward = object.find("reward");
  if (reward == object.end() || !reward->is_number()) return absl::DataLossError("no number \"reward\"");
  episode.reward = reward->get<double>();
  for (int i = 0; i < kNumAchievements; ++i) {
    CRAFTFLEET_ASSIGN_OR_RETURN(episode.achievements[i],
                                ReadInteger(object, absl::StrCat("achievement_", kAchievementNames[i]), 0,
                                            std::numeric_limits<int32_t>::max()));
  }
  if (object.size() != kKeys) {
    return absl::DataLossError(absl::StrCat("has ", object.size(), " keys, want ", kKeys));
  }
  return episode;
}

}  // namespace

double RoundReward(double reward) {
  double rounded = 0;
  CRAFTFLEET_CHECK(absl::SimpleAtod(FormatReward(reward), &rounded));
  return rounded;
}

std::string FormatStatsLine(const Episode& episode) {
  std::string line = absl::StrCat("{\"length\": ", episode.length, ", \"reward\": ", FormatReward(episode.reward));
  for (int i = 0; i < kNumAchievements; ++i) {
    absl::StrAppend(&line, ", \"achievement_", kAchievementNames[i], "\": ", episode.achievements[i]);
  }
  line += "}\n";
  return line;
}

absl::StatusOr<std::vector<Episode>> ReadStats(const std::string& path) {
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string text, ReadGzipFile(path));
  return ParseStats(text, path);
}

absl::StatusOr<std::vector<Episode>> ParseStats(absl::string_view text, absl::string_view path) {
  std::vector<Episode> episodes;
  std::vector<absl::string_view> lines = absl::StrSplit(text, '\n');
  const bool cut_off = !lines.back().empty();
  lines.pop_back();
  for (const absl::string_view line : lines) {
    absl::StatusOr<Episode> episode = ParseStatsLine(line);
    if (!episode.ok()) {
      return absl::DataLossError(absl::StrCat(path, ":", episodes.size() + 1, ": ", episode.status().message()));
    }
    episodes.push_back(*std::move(episode));
  }
  if (cut_off) return absl::DataLossError(absl::StrCat(path, ":", lines.size() + 1, ": the line is cut off"));
  return episodes;
}

absl::Status StatsLog::Append(absl::Span<const Episode> episodes) {
  std::string lines;
  for (const Episode& episode : episodes) lines += FormatStatsLine(episode);
  return file_.Append(lines);
}

}  // namespace craftfleet
