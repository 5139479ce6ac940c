#!/usr/bin/env bash
# Runs one process of a fleet within a Slurm step, listening on any free port of its own host, and notes when Slurm stops
# the step: it signals all of a step's processes, so this shell need not pass anything on.
#
# Usage, by fleet.sbatch: step.sh FILE PROGRAM [FLAG]...
#   FILE  is made at SIGTERM; may be /dev/null

set -uo pipefail

note=$1
shift
trap 'touch "$note"' TERM
"$@" --listen="$(hostname):0" &
while true; do
  wait $!
  status=$?
  kill -0 $! 2>/dev/null || exit "$status"  # else a signal ended the wait
done
