#include "learner/run/final_logs.h"

#include <algorithm>
#include <array>
#include <cstdint>
#include <vector>

#include <absl/strings/match.h>
#include <absl/strings/numbers.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/strip.h>

#include "common/base/status_macros.h"
#include "common/io/files.h"
#include "learner/run/append_file.h"

namespace craftfleet {
namespace {

constexpr std::array<absl::string_view, 2> kLogs = {"final_argmax.jsonl", "final_sampled.jsonl"};
constexpr absl::string_view kEnding = ".jsonl";

// The environment steps of the checkpoint's final evaluation.
int64_t StepsOf(const v1::CheckpointState& state) {
  return state.final_evaluation_steps() > 0 ? state.final_evaluation_steps() : state.env_steps();
}

// "final_argmax-4096.jsonl"
std::string AsideName(absl::string_view log, int64_t steps) {
  return absl::StrCat(absl::StripSuffix(log, kEnding), "-", steps, kEnding);
}

// The steps in a name made by AsideName; -1: any other name.
int64_t StepsInName(absl::string_view name) {
  for (const absl::string_view log : kLogs) {
    absl::string_view rest = name;
    int64_t steps = 0;
    if (absl::ConsumePrefix(&rest, absl::StrCat(absl::StripSuffix(log, kEnding), "-")) &&
        absl::ConsumeSuffix(&rest, kEnding) && absl::SimpleAtoi(rest, &steps)) {
      return steps;
    }
  }
  return -1;
}

bool HasLines(absl::string_view log, const v1::CheckpointState& state) {
  return std::any_of(state.logs().begin(), state.logs().end(),
                     [&](const v1::LogLength& length) { return length.file() == log && length.bytes() > 0; });
}

absl::Status SetAside(const std::string& logdir, absl::string_view log, int64_t steps, int64_t bytes) {
  const std::string aside = JoinPath(logdir, AsideName(log, steps));
  if (PathExists(aside)) return absl::OkStatus();  // already set aside; the file under the log's own name is newer
  const std::string path = JoinPath(logdir, log);
  CRAFTFLEET_ASSIGN_OR_RETURN(AppendFile file, AppendFile::Open(path));
  CRAFTFLEET_RETURN_IF_ERROR(file.TruncateTo(bytes));
  return RenameSynced(path, aside);
}

}  // namespace

std::string FindFinalLog(const std::string& logdir, absl::string_view name, const v1::CheckpointState& state) {
  const bool is_final = std::find(kLogs.begin(), kLogs.end(), name) != kLogs.end();
  const std::string aside = JoinPath(logdir, AsideName(name, StepsOf(state)));
  return is_final && HasLines(name, state) && PathExists(aside) ? aside : JoinPath(logdir, name);
}

absl::Status RestoreFinalLogs(const std::string& logdir, const v1::CheckpointState& state) {
  for (const absl::string_view log : kLogs) {
    const std::string path = JoinPath(logdir, log);
    const std::string found = FindFinalLog(logdir, log, state);
    if (found != path) CRAFTFLEET_RETURN_IF_ERROR(RenameSynced(found, path));
  }
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::vector<std::string> names, ListFolder(logdir));
  for (const std::string& name : names) {
    if (StepsInName(name) > state.env_steps()) CRAFTFLEET_RETURN_IF_ERROR(RemoveAll(JoinPath(logdir, name)));
  }
  return absl::OkStatus();
}

absl::Status SetFinalLogsAside(const std::string& logdir, v1::CheckpointState* state) {
  for (v1::LogLength& log : *state->mutable_logs()) {
    const bool is_final = std::find(kLogs.begin(), kLogs.end(), log.file()) != kLogs.end();
    if (!is_final || log.bytes() == 0) continue;
    CRAFTFLEET_RETURN_IF_ERROR(SetAside(logdir, log.file(), StepsOf(*state), log.bytes()));
    log.set_bytes(0);
  }
  return absl::OkStatus();
}

}  // namespace craftfleet
