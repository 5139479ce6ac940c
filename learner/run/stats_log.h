// stats.jsonl: one JSON object per finished episode, as Crafter's own recorder writes it.
// Format: FORMATS.md, section 3. Crafter's analysis scripts read this file.

#pragma once

#include <cstdint>
#include <string>

#include <absl/functional/function_ref.h>
#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>

#include "common/base/types.h"

namespace craftfleet {

// Rounds like Python's round(reward, 1): on the exact binary value, ties to even.
double RoundReward(double reward);

// Formats {"length": 163, "reward": 1.1, "achievement_collect_coal": 0, ...} and a newline, byte for byte like Python's
// json.dumps.
std::string FormatStatsLine(const Episode& episode);

// The inverse, for a line without its newline; `step` of the episode is 0 and the reward is rounded.
//   DataLoss: not a JSON object, or a key is missing, additional or mistyped; names the key.
absl::StatusOr<Episode> ParseStatsLine(absl::string_view line);

// Calls `visit` for each episode in the first `bytes` of a stats.jsonl, 0 or more; the rest is not read.
//   DataLoss: it has fewer bytes, its last line is incomplete, or as ParseStatsLine; names the line.
//   Others as FileError (common/io/files.h): it cannot be read.
absl::Status VisitStats(const std::string& path, int64_t bytes, absl::FunctionRef<void(const Episode&)> visit);

}  // namespace craftfleet
