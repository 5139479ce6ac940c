#!/usr/bin/env bash
# From a fresh checkout to a trained agent: installs missing packages, builds, trains PPO-CNN on Crafter in one process,
# evaluates it, and lists the results.
#
# Usage: deploy/quickstart.sh [--steps=N] [--seed=N]
#   --steps=N  environment steps to train for; default 100000
#   --seed=N   seed of the run; default 1

set -euo pipefail

usage() { sed -n '2,/^$/s/^# \{0,1\}//p' "$0"; }
steps=100000
seed=1
for argument in "$@"; do
  case "$argument" in
    -h | --help) usage; exit 0 ;;
    --steps=*) steps=${argument#*=} ;;
    --seed=*) seed=${argument#*=} ;;
    *) echo "quickstart.sh: unknown argument '$argument'" >&2; usage >&2; exit 2 ;;
  esac
done
if ! [[ $steps =~ ^[0-9]+$ && $seed =~ ^[0-9]+$ ]]; then
  echo "quickstart.sh: --steps=$steps --seed=$seed, want whole numbers" >&2
  exit 2
fi
cd "$(dirname "$(readlink -f "$0")")/.."

# Announces a step, with what it may take on two cores. Argument: what it does.
started=$SECONDS
step=0
say() {
  step=$((step + 1))
  printf '\n[%d/4, %d:%02d so far] %s\n' "$step" $(((SECONDS - started) / 60)) $(((SECONDS - started) % 60)) "$*"
}

say "Installing the packages that are missing: up to 350 MB, one to three minutes."
deploy/install-deps.sh --core
say "Building the programs: the longest step, about five minutes on two cores; a line counts the files. Tests are left out."
deploy/build.sh release -DCRAFTFLEET_BUILD_TESTS=OFF

number=1
while [ -e "runs/quickstart-$number" ]; do number=$((number + 1)); done
logdir=runs/quickstart-$number

say "Training PPO-CNN on Crafter for $steps steps into $logdir, a minute or two per 100,000 (stop it with Ctrl-C; it can be resumed)."
build/bin/craftfleet train --agent=ppo_cnn --env=crafter --steps="$steps" --seed="$seed" --lanes=16 --logdir="$logdir"

say "Evaluating its last checkpoint over 20 episodes: a few seconds."
build/bin/craftfleet eval --checkpoint="$logdir" --episodes=20

cat <<RESULTS

Done in $(((SECONDS - started) / 60)):$(printf %02d $(((SECONDS - started) % 60))). Results in $logdir:
  stats.jsonl     one line per training episode, as Crafter's own recorder writes it
  events.out.*    curves; watch them with: tensorboard --logdir $logdir
  checkpoints/    weights and everything needed to resume
  config.txt      the configuration as it ran
RESULTS
if ! grep -qs '^OPENCV_highgui_LIBRARY:[A-Z]*=/' build/CMakeCache.txt; then
  cat <<'MORE'

The programs are in build/bin. They show games in the terminal: build/bin/craftfleet watch --terminal RUN
For windows, videos and plots as well: deploy/install-deps.sh && deploy/build.sh
MORE
fi
