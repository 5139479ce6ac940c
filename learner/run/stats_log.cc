#include "learner/run/stats_log.h"

#include <cerrno>
#include <fstream>
#include <limits>

#include <absl/strings/numbers.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/strings/string_view.h>
#include <nlohmann/json.hpp>

#include "common/base/check.h"
#include "common/base/crafter.h"
#include "common/base/status_macros.h"
#include "common/io/files.h"

namespace craftfleet {
namespace {

constexpr size_t kKeys = 2 + kNumAchievements;

std::string FormatReward(double reward) { return absl::StrFormat("%.1f", reward); }

absl::StatusOr<int64_t> ReadInteger(const nlohmann::json& object, const std::string& key, int64_t low, int64_t high) {
  const auto found = object.find(key);
  if (found == object.end()) return absl::DataLossError(absl::StrCat("no \"", key, "\""));
  if (!found->is_number_integer() || *found < low || *found > high) {
    return absl::DataLossError(absl::StrCat(
        "\"", key, "\" is ", found->is_structured() ? found->type_name() : found->dump(), ", want ", low, "..", high));
  }
  return found->get<int64_t>();
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

absl::Status VisitStats(const std::string& path, int64_t bytes, absl::FunctionRef<void(const Episode&)> visit) {
  std::ifstream file(path);
  if (!file.is_open()) return FileError(errno, "cannot open", path);
  int64_t read = 0;
  int64_t lines = 0;
  std::string line;
  while (read < bytes && std::getline(file, line)) {
    ++lines;
    const bool has_end = !file.eof();
    read += static_cast<int64_t>(line.size()) + (has_end ? 1 : 0);
    if (!has_end && read < bytes) break;
    const absl::StatusOr<Episode> episode =
        has_end && read <= bytes ? ParseStatsLine(line) : absl::DataLossError("the line is incomplete");
    if (!episode.ok()) return absl::DataLossError(absl::StrCat(path, ":", lines, ": ", episode.status().message()));
    visit(*episode);
  }
  if (file.bad()) return FileError(errno, "cannot read", path);
  if (read == bytes) return absl::OkStatus();
  return absl::DataLossError(absl::StrCat(path, " has ", read, " bytes, but the checkpoint expects ", bytes));
}

}  // namespace craftfleet
