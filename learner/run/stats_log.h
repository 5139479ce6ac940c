// stats.jsonl: one JSON object per finished episode, as Crafter's own recorder writes it.
// Format: FORMATS.md, section 3. Crafter's analysis scripts read this file.

#ifndef CRAFTFLEET_LEARNER_RUN_STATS_LOG_H_
#define CRAFTFLEET_LEARNER_RUN_STATS_LOG_H_

#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include <absl/functional/function_ref.h>
#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>
#include <absl/types/span.h>

#include "common/base/types.h"
#include "learner/run/append_file.h"

namespace craftfleet {

// Rounds like Python's round(reward, 1): on the exact binary value, ties to even.
double RoundReward(double reward);

// Formats {"length": 163, "reward": 1.1, "achievement_collect_coal": 0, ...} and a newline, byte for byte like Python's
// json.dumps.
std::string FormatStatsLine(const Episode& episode);

// Parses `text`, a whole stats.jsonl. Errors name `path` and the line, as below.
absl::StatusOr<std::vector<Episode>> ParseStats(absl::string_view text, absl::string_view path);

// Reads a whole stats.jsonl, gzipped or plain; `step` of the episodes is 0 and rewards are rounded.
//   NotFound: no such file.   DataLoss: damaged gzip data, or a line that is incomplete, is not a JSON object, or has a
//   missing, additional or mistyped key; names the line and the key.
absl::StatusOr<std::vector<Episode>> ReadStats(const std::string& path);

// The same for a log of any length: calls `visit` for each episode instead of storing them.
absl::Status VisitStats(const std::string& path, absl::FunctionRef<void(const Episode&)> visit);
// The same for the first `bytes` of it, 0 or more; the rest is not read.
//   DataLoss: the file has fewer.
absl::Status VisitStats(const std::string& path, int64_t bytes, absl::FunctionRef<void(const Episode&)> visit);

// Thread-compatible: one thread at a time.
class StatsLog {
 public:
  explicit StatsLog(AppendFile file) : file_(std::move(file)) {}

  // Appends a line per episode; file().Flush() writes them.
  void Append(absl::Span<const Episode> episodes);

  AppendFile& file() { return file_; }
  const AppendFile& file() const { return file_; }

 private:
  AppendFile file_;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_RUN_STATS_LOG_H_
