"""A sweep as an array job of Slurm."""

from __future__ import annotations

import shlex

STOPPED = 75  # EX_TEMPFAIL: the exit code of a sweep that a signal stopped before its runs were done; its task is requeued

_SCRIPT = """#!/usr/bin/env bash
# Written by craftfleet sweep --executor=slurm: one task for each run.
#SBATCH --job-name=craftfleet-sweep
#SBATCH --array=0-{last}%{at_a_time}
#SBATCH --output="{logs}/%A_%a.log"
#SBATCH --open-mode=append
#SBATCH --requeue
#SBATCH --signal=TERM@60
#SBATCH --ntasks=1
#SBATCH --cpus-per-task={threads}

runs=(
  {runs}
)
trap : TERM  # this shell waits until the run has stopped
srun --cpu-bind=none {command} --run="${{runs[SLURM_ARRAY_TASK_ID]}}" --threads="$SLURM_CPUS_PER_TASK" &
while true; do
  wait $!
  status=$?
  kill -0 $! 2>/dev/null || break  # otherwise a signal interrupted the wait
done
job=${{SLURM_ARRAY_JOB_ID}}_$SLURM_ARRAY_TASK_ID
if [ "$status" -eq {stopped} ] && [ "$(squeue --noheader --jobs="$job" --format=%T)" = RUNNING ]; then
  echo "stopped by Slurm; requeueing the task"
  exec scontrol requeue "$job"
fi
exit "$status"
"""


def script(logs: str, at_a_time: int, threads: int, command: list[str], runs: list[str]) -> str:
  """The script for sbatch, self-contained because sbatch copies it. Task k runs `command` with --run=RUN_K.

  Args:
    logs: folder for the output of the tasks.
    at_a_time: tasks that may run at the same time, with `threads` CPUs each.
    command: craftfleet sweep and its arguments, without --run and --threads.
    runs: their names.
  """
  # In a directive of sbatch %% is a %, and quotes keep spaces.
  logs = logs.replace("%", "%%").replace("\\", "\\\\").replace('"', '\\"')
  return _SCRIPT.format(last=len(runs) - 1, at_a_time=at_a_time, logs=logs, threads=threads, runs="\n  ".join(map(shlex.quote, runs)),
                        command=shlex.join(command), stopped=STOPPED)
