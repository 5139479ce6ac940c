#include "deploy/cli/sweep/slurm_array.h"

#include <algorithm>

#include <absl/strings/ascii.h>
#include <absl/strings/match.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_join.h>
#include <absl/strings/str_replace.h>

namespace craftfleet {
namespace {

constexpr char kScript[] = R"sh(#!/usr/bin/env bash
# Written by craftfleet sweep --executor=slurm: one task for each run.
#SBATCH --job-name=craftfleet-sweep
#SBATCH --array=0-<LAST>%<AT A TIME>
#SBATCH --output=<LOGS>
#SBATCH --open-mode=append
#SBATCH --requeue
#SBATCH --signal=TERM@60
#SBATCH --ntasks=1
#SBATCH --cpus-per-task=<THREADS>

runs=(
  <RUNS>
)
trap : TERM  # this shell waits until the run has stopped
srun --cpu-bind=none <COMMAND> --run="${runs[SLURM_ARRAY_TASK_ID]}" --threads="$SLURM_CPUS_PER_TASK" &
while true; do
  wait $!
  status=$?
  kill -0 $! 2>/dev/null || break  # otherwise a signal interrupted the wait
done
job=${SLURM_ARRAY_JOB_ID}_$SLURM_ARRAY_TASK_ID
if [ "$status" -eq <STOPPED> ] && [ "$(squeue --noheader --jobs="$job" --format=%T)" = RUNNING ]; then
  echo "stopped by Slurm; requeueing the task"
  exec scontrol requeue "$job"
fi
exit "$status"
)sh";

bool IsPlain(char c) { return absl::ascii_isalnum(c) || absl::StrContains("_-+=:,./@%", c); }

// The path of a log in a directive of sbatch: %% is a %, quotes keep spaces. `pattern` has placeholders of its own.
std::string DirectiveWord(absl::string_view folder, absl::string_view pattern) {
  return absl::StrCat("\"", absl::StrReplaceAll(folder, {{"%", "%%"}, {"\\", "\\\\"}, {"\"", "\\\""}}), pattern, "\"");
}

std::string ShellWords(const std::vector<std::string>& words, absl::string_view separator) {
  return absl::StrJoin(words, separator,
                       [](std::string* out, const std::string& word) { absl::StrAppend(out, ShellWord(word)); });
}

}  // namespace

std::string ShellWord(absl::string_view word) {
  if (!word.empty() && std::all_of(word.begin(), word.end(), IsPlain)) return absl::StrCat(word);
  return absl::StrCat("'", absl::StrReplaceAll(word, {{"'", "'\\''"}}), "'");
}

std::string SlurmArrayScript(const SlurmArray& array) {
  return absl::StrReplaceAll(kScript, {{"<LAST>", absl::StrCat(array.runs.size() - 1)},
                                       {"<AT A TIME>", absl::StrCat(array.at_a_time)},
                                       {"<LOGS>", DirectiveWord(array.logs, "/%A_%a.log")},
                                       {"<THREADS>", absl::StrCat(array.threads)},
                                       {"<RUNS>", ShellWords(array.runs, "\n  ")},
                                       {"<COMMAND>", ShellWords(array.command, " ")},
                                       {"<STOPPED>", absl::StrCat(kSweepStopped)}});
}

}  // namespace craftfleet
