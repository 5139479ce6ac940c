// A sweep as an array of Slurm: one task for each run.

#ifndef CRAFTFLEET_DEPLOY_EXPERIMENT_SLURM_ARRAY_H_
#define CRAFTFLEET_DEPLOY_EXPERIMENT_SLURM_ARRAY_H_

#include <string>
#include <vector>

#include <absl/strings/string_view.h>

namespace craftfleet {

// Exit code of a sweep that a signal stopped with runs left: the script that Slurm runs puts itself back into the
// queue.
inline constexpr int kSweepStopped = 75;  // EX_TEMPFAIL of sysexits.h

struct SlurmArray {
  std::string logs;                  // folder of the tasks' own output
  int at_a_time = 1;                 // tasks that may run side by side
  int threads = 1;                   // CPUs of each
  std::vector<std::string> command;  // craftfleet-sweep and its arguments, but for --run and --threads
  std::vector<std::string> runs;     // names, as SweepJob::name
};

// The script for sbatch: task k runs `command` with --run=<runs[k]>, in the state in which it finds the run's folder,
// and is requeued when it is stopped from outside. It has all it needs in itself, because sbatch keeps a copy.
std::string SlurmArrayScript(const SlurmArray& array);

// `word` as one word of a shell's command line.
std::string ShellWord(absl::string_view word);

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_EXPERIMENT_SLURM_ARRAY_H_
