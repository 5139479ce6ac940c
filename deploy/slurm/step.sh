#!/usr/bin/env bash
# Runs one process of a fleet in a Slurm step, listening on any free port of its host, and creates a file when Slurm stops
# the step. Slurm signals all processes of a step, so this shell need not forward the signal.
#
# Usage, by fleet.sbatch: step.sh FILE PROGRAM [FLAG]...
#   FILE  is created at SIGTERM; may be /dev/null

set -uo pipefail

note=$1
shift
trap 'touch "$note"' TERM
"$@" --listen="$("$(dirname "$(readlink -f "$0")")/own-host.sh"):0" &
while true; do
  wait $!
  status=$?
  kill -0 $! 2>/dev/null || exit "$status"  # otherwise a signal interrupted the wait
done
