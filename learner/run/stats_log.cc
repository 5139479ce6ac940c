#include "learner/run/stats_log.h"

#include <algorithm>
#include <cstdint>
#include <limits>

#include <absl/strings/numbers.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/strings/string_view.h>
#include <nlohmann/json.hpp>

#include "common/base/check.h"
#include "common/base/crafter.h"
#include "common/base/status_macros.h"
#include "common/io/gzip_file.h"

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

// Parses a stats.jsonl that arrives in pieces.
class StatsReader {
 public:
  explicit StatsReader(absl::string_view path) : path_(path) {}

  absl::Status Read(absl::string_view piece, absl::FunctionRef<void(const Episode&)> visit) {
    absl::StrAppend(&rest_, piece);
    size_t start = 0;
    for (size_t end = 0; (end = rest_.find('\n', start)) != std::string::npos; start = end + 1) {
      const auto episode = ParseStatsLine(absl::string_view(rest_).substr(start, end - start));
      ++lines_;
      if (!episode.ok()) return Error(episode.status().message());
      visit(*episode);
    }
    rest_.erase(0, start);
    return absl::OkStatus();
  }
  absl::Status End() {
    if (rest_.empty()) return absl::OkStatus();
    ++lines_;
    return Error("the line is incomplete");
  }

 private:
  absl::Status Error(absl::string_view what) const {
    return absl::DataLossError(absl::StrCat(path_, ":", lines_, ": ", what));
  }

  const absl::string_view path_;
  std::string rest_;  // the incomplete line at the end of the last piece
  int64_t lines_ = 0;
};

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
  std::vector<Episode> episodes;
  CRAFTFLEET_RETURN_IF_ERROR(VisitStats(path, [&](const Episode& episode) { episodes.push_back(episode); }));
  return episodes;
}

absl::Status VisitStats(const std::string& path, absl::FunctionRef<void(const Episode&)> visit) {
  StatsReader reader(path);
  CRAFTFLEET_RETURN_IF_ERROR(ReadGzipPieces(path, [&](absl::string_view piece) { return reader.Read(piece, visit); }));
  return reader.End();
}

absl::Status VisitStats(const std::string& path, int64_t bytes, absl::FunctionRef<void(const Episode&)> visit) {
  StatsReader reader(path);
  int64_t left = bytes;
  const absl::Status read = ReadGzipPieces(path, [&](absl::string_view piece) {
    piece = piece.substr(0, std::min<uint64_t>(piece.size(), left));
    left -= static_cast<int64_t>(piece.size());
    return reader.Read(piece, visit);
  });
  CRAFTFLEET_RETURN_IF_ERROR(read);
  if (left > 0) {
    return absl::DataLossError(absl::StrCat(path, " has ", bytes - left, " bytes, but the checkpoint expects ", bytes));
  }
  return reader.End();
}

absl::StatusOr<std::vector<Episode>> ParseStats(absl::string_view text, absl::string_view path) {
  std::vector<Episode> episodes;
  StatsReader reader(path);
  CRAFTFLEET_RETURN_IF_ERROR(reader.Read(text, [&](const Episode& episode) { episodes.push_back(episode); }));
  CRAFTFLEET_RETURN_IF_ERROR(reader.End());
  return episodes;
}

void StatsLog::Append(absl::Span<const Episode> episodes) {
  for (const Episode& episode : episodes) file_.Append(FormatStatsLine(episode));
}

}  // namespace craftfleet
