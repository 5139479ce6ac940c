#!/usr/bin/env bash
# Copies the results of a finished run: configuration, versions and seed, episode and evaluation logs (gzipped), and its
# learning curve, without event files and optimiser.
#
# Usage: deploy/experiments/collect.sh [--weights] RUN_FOLDER RESULT_FOLDER
#   --weights  also the newest checkpoint's weights

set -euo pipefail

usage() { sed -n '2,/^$/s/^# \{0,1\}//p' "$0"; }
weights=
while [ $# -gt 0 ]; do
  case "$1" in
    -h | --help) usage; exit 0 ;;
    --weights) weights=yes; shift ;;
    -*) echo "collect.sh: unknown argument '$1'" >&2; usage >&2; exit 2 ;;
    *) break ;;
  esac
done
[ $# -eq 2 ] || { usage >&2; exit 2; }
run=$1
result=$2
[ -f "$run/config.txt" ] || { echo "collect.sh: $run is not a run folder: it has no config.txt" >&2; exit 1; }

# Everything is made beside the result and then moved, so that a full disk leaves no half file in it.
mkdir -p "$result"
made=$(mktemp -d "$result/.collect.XXXXXX")
trap 'rm -rf "$made"' EXIT
cp "$run/config.txt" "$run/run.json" "$made/"
for log in stats eval_argmax eval_sampled final_argmax final_sampled; do
  [ ! -s "$run/$log.jsonl" ] || gzip -9 --no-name --stdout "$run/$log.jsonl" >"$made/$log.jsonl.gz"
done
if [ -n "$weights" ]; then
  newest=$(find "$run/checkpoints" -maxdepth 1 -regex '.*/iter-[0-9]+' | sort | tail -n 1)
  cp "$newest/weights.safetensors" "$made/"
fi
"$(dirname "$(readlink -f "$0")")/../../build/bin/craftfleet" curve --out="$made/curve.png" "$run"
mv "$made"/* "$result/"
