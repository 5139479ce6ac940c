#!/usr/bin/env bash
# One learner with many actors over real connections, which play nothing, and many lanes: are shares fair, does the status
# service answer quickly, does the learner's memory stand still?
#
# Usage: tests/chaos/scale.sh [--seconds=600] [--actors=200] [--lanes=1000]

set -euo pipefail
seconds=600
actors=200
lanes=1000
for argument in "$@"; do
  case "$argument" in
    --seconds=*) seconds=${argument#*=} ;;
    --actors=*) actors=${argument#*=} ;;
    --lanes=*) lanes=${argument#*=} ;;
    *) sed -n '2,/^$/s/^# \{0,1\}//p' "$0"; exit 2 ;;
  esac
done
cd "$(dirname "$0")/../.."

folder=$(mktemp -d)
trap 'kill "$learner" 2>/dev/null; wait "$learner" 2>/dev/null; rm -rf "$folder"' EXIT
cat >"$folder/config.txt" <<CONFIG
steps: 1000000000 lanes: $lanes fragment_steps: 4
ppo { rollout_steps: $((4 * lanes)) minibatch_size: 100 epochs: 1 }
eval { every_steps: 0 final_episodes: 0 }
CONFIG
build/bin/craftfleet-learner --config="$folder/config.txt" --logdir="$folder/run" --listen=127.0.0.1:0 --threads=1 \
  >"$folder/out" 2>"$folder/err" &
learner=$!
until address=$(sed -n 's/.*listening on \([0-9.:]*\).*/\1/p' "$folder/err") && [ -n "$address" ]; do sleep 0.1; done

resident() { awk '/^VmRSS:/ {print $2}' "/proc/$learner/status"; }
build/bin/many_actors --learner="$address" --actors="$actors" --seconds="$seconds" &
bots=$!
sleep $((seconds / 5))
early=$(resident)
sleep $((seconds * 7 / 10))
late=$(resident)
result=0
wait "$bots" || result=1
echo "learner: $early KiB resident after a fifth of the time, $late KiB after nine tenths"
[ $((late - early)) -le $((early / 20)) ] || { echo "it has grown"; result=1; }
exit $result
