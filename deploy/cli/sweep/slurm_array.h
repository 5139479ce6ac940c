// A sweep as a Slurm array job: one task per run.

#ifndef CRAFTFLEET_DEPLOY_CLI_SWEEP_SLURM_ARRAY_H_
#define CRAFTFLEET_DEPLOY_CLI_SWEEP_SLURM_ARRAY_H_

#include <string>
#include <vector>

#include <absl/strings/string_view.h>

namespace craftfleet {

// Exit code of a sweep that a signal stopped before all its runs were done. The Slurm script then requeues its task.
inline constexpr int kSweepStopped = 75;  // EX_TEMPFAIL of sysexits.h

struct SlurmArray {
  std::string logs;                  // folder for the output of the tasks
  int at_a_time = 1;                 // tasks that may run at the same time
  int threads = 1;                   // CPUs per task
  std::vector<std::string> command;  // craftfleet-sweep and its arguments, without --run and --threads
  std::vector<std::string> runs;     // names, as SweepJob::name
};

// The script for sbatch. Task k runs `command` with --run=<runs[k]>, which starts or resumes the run; if Slurm stops
// the task, it is requeued. The script is self-contained, because sbatch copies it.
std::string SlurmArrayScript(const SlurmArray& array);

// Quotes `word` as one word of a shell command.
std::string ShellWord(absl::string_view word);

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_CLI_SWEEP_SLURM_ARRAY_H_
