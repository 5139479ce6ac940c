#include "deploy/cli/plot/learning_curve.h"

#include <algorithm>
#include <array>
#include <filesystem>
#include <system_error>

#include <absl/strings/ascii.h>
#include <absl/strings/numbers.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_split.h>

#include "common/base/status_macros.h"
#include "common/io/files.h"
#include "learner/run/score.h"
#include "learner/run/stats_log.h"

namespace craftfleet {
namespace {

enum Column { kEpisodes, kSteps, kReward, kScore, kNumColumns };
constexpr std::array<absl::string_view, kNumColumns> kColumns = {"episodes", "steps", "ep_rew_mean100",
                                                                 "crafter_score_cum"};

// The stats file of `path`, which is a run folder or the file itself.
absl::StatusOr<std::string> FindStats(const std::string& path) {
  if (!PathExists(path)) return absl::NotFoundError(absl::StrCat(path, ": no such run folder or file"));
  std::error_code ignored;
  if (!std::filesystem::is_directory(path, ignored)) return path;
  for (const char* name : {"stats.jsonl", "stats.jsonl.gz"}) {
    if (std::string file = JoinPath(path, name); PathExists(file)) return file;
  }
  return absl::NotFoundError(absl::StrCat(path, ": not a run folder: it has no stats.jsonl"));
}

}  // namespace

LearningCurve CurveOfEpisodes(absl::Span<const Episode> episodes) {
  LearningCurve curve;
  curve.reserve(episodes.size());
  ScoreBoard board;
  int64_t steps = 0;
  for (const Episode& episode : episodes) {
    board.Add(episode);
    steps += episode.length;
    curve.push_back({board.episodes(), steps, board.RecentReward(), board.Score()});
  }
  return curve;
}

absl::StatusOr<LearningCurve> ReadRunCurve(const std::string& path) {
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string file, FindStats(path));
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::vector<Episode> episodes, ReadStats(file));
  if (episodes.empty()) return absl::FailedPreconditionError(absl::StrCat(file, ": no episode has finished yet"));
  return CurveOfEpisodes(episodes);
}

absl::StatusOr<LearningCurve> ReadReferenceCurve(const std::string& path) {
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string text, ReadFile(path));
  const std::vector<absl::string_view> lines = absl::StrSplit(absl::StripTrailingAsciiWhitespace(text), '\n');
  const std::vector<absl::string_view> names = absl::StrSplit(absl::StripAsciiWhitespace(lines[0]), ',');
  std::array<size_t, kNumColumns> index;
  for (int column = 0; column < kNumColumns; ++column) {
    index[column] = std::find(names.begin(), names.end(), kColumns[column]) - names.begin();
    if (index[column] == names.size()) {
      return absl::InvalidArgumentError(absl::StrCat(path, ":1: no column \"", kColumns[column], "\""));
    }
  }
  LearningCurve curve;
  for (size_t line = 1; line < lines.size(); ++line) {
    const std::vector<absl::string_view> cells = absl::StrSplit(absl::StripAsciiWhitespace(lines[line]), ',');
    std::array<double, kNumColumns> values;
    for (int column = 0; column < kNumColumns; ++column) {
      const absl::string_view cell = index[column] < cells.size() ? cells[index[column]] : "";
      if (!absl::SimpleAtod(cell, &values[column])) {
        return absl::InvalidArgumentError(
            absl::StrCat(path, ":", line + 1, ": ", kColumns[column], " is \"", cell, "\", want a number"));
      }
    }
    curve.push_back({static_cast<int64_t>(values[kEpisodes]), static_cast<int64_t>(values[kSteps]), values[kReward],
                     values[kScore]});
  }
  if (curve.empty()) return absl::InvalidArgumentError(absl::StrCat(path, ": no line after the column names"));
  return curve;
}

}  // namespace craftfleet
