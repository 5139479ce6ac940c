#!/usr/bin/env bash
# PPO-CNN with the paper's settings at learning rate 3e-4: three seeds, one after the other, then their learning curves.
# If it is stopped, the same command continues where it was. Complete runs are kept.
#
# Usage: deploy/experiments/ppo_cnn_300k/run.sh [--reference=FILE.csv,...] [--steps=N] [--runs=DIR] [--results=DIR]
#   --reference=FILE.csv,...  runs of other programs to draw with the curves, as for craftfleet curve
#   --steps=N                 environment steps of each run; default 300000
#   --runs=DIR                folder of the runs; default runs/ppo_cnn_300k
#   --results=DIR             folder of the results; default deploy/experiments/results/ppo_cnn_300k
#
# Needs the programs in build/bin (deploy/build.sh). Results: seed<k>/config.txt, seed<k>/stats.jsonl.gz, curve.png.

set -euo pipefail

usage() { sed -n '2,/^$/s/^# \{0,1\}//p' "$0"; }
root=$(readlink -f "$(dirname "$(readlink -f "$0")")/../../..")
reference=
steps=300000
runs=$root/runs/ppo_cnn_300k
results=$root/deploy/experiments/results/ppo_cnn_300k
for argument in "$@"; do
  case "$argument" in
    -h | --help) usage; exit 0 ;;
    --reference=*) reference=${argument#*=} ;;
    --steps=*) steps=${argument#*=} ;;
    --runs=*) runs=${argument#*=} ;;
    --results=*) results=${argument#*=} ;;
    *) echo "run.sh: unknown argument '$argument'" >&2; usage >&2; exit 2 ;;
  esac
done
craftfleet=$root/build/bin/craftfleet

seeds=(1 2 3)
for seed in "${seeds[@]}"; do
  run=$runs/seed$seed
  echo "== seed $seed: $run"
  if compgen -G "$run/checkpoints/iter-*" >/dev/null; then
    "$craftfleet" train --resume --steps="$steps" --logdir="$run"
  else
    "$craftfleet" train --config="$root/deploy/experiments/ppo_cnn_300k/config.txt" --steps="$steps" --seed="$seed" --logdir="$run"
  fi
done

collected=()
for seed in "${seeds[@]}"; do
  mkdir -p "$results/seed$seed"
  cp "$runs/seed$seed/config.txt" "$results/seed$seed/"
  gzip -9nc "$runs/seed$seed/stats.jsonl" >"$results/seed$seed/stats.jsonl.gz"
  collected+=("$results/seed$seed")
done
"$craftfleet" curve --out="$results/curve.png" --reference="$reference" "${collected[@]}"
echo "Results in $results"
