#!/usr/bin/env bash
# Learns as much as possible from fifteen minutes on a GPU, in two parts. Each step has a limit of its own and writes what it
# learns at once: <out>/<step>.log, and a line in <out>/steps.txt. OC-SA trains in the background from the end of part a on.
# Needs bash and Python with torch, and programs from a build against the same LibTorch.
#
# Usage: deploy/gpu_session.sh bundle --bin=DIR --out=DIR     copies the programs of a build with the libraries that they need:
#                                 without video and windows (as of the preset wheel) 100 MB, otherwise 400 MB
#        deploy/gpu_session.sh a|b --bin=DIR --out=DIR [OPTION]...
#   a                 the machine, a smoke run, device_check, short runs of each agent
#   b                 waits for OC-SA, keeps its weights, log and score, then trains PPO-CNN for a million steps
#   --bin=DIR         folder of the programs, such as bundle/bin
#   --out=DIR         folder for the results
#   --device=DEVICE   cuda (default), cuda:N, or cpu to try this script
#   --work=DIR        folder of OC-SA's run, the same in a and b; default: /tmp/craftfleet-gpu
#   --seconds=N       of the part; default: 300 for a, 450 for b
#   --small           few steps and small frames, to try this script

set -euo pipefail

usage() { sed -n '2,/^$/s/^# \{0,1\}//p' "$0"; }
refuse() { echo "gpu_session.sh: $*" >&2; exit 2; }
part='' bin='' out='' device=cuda work=/tmp/craftfleet-gpu seconds='' small=''
for argument in "$@"; do
  case "$argument" in
    -h | --help) usage; exit 0 ;;
    a | b | bundle) part=$argument ;;
    --bin=?*) bin=${argument#*=} ;;
    --out=?*) out=${argument#*=} ;;
    --device=?*) device=${argument#*=} ;;
    --work=?*) work=${argument#*=} ;;
    --seconds=?*) seconds=${argument#*=} ;;
    --small) small=yes ;;
    *) refuse "unknown argument '$argument'; see --help" ;;
  esac
done
[[ -n $part && -n $bin && -n $out ]] || refuse "want a, b or bundle, --bin and --out; see --help"
[ -x "$bin/craftfleet" ] || refuse "--bin=$bin: no craftfleet there"
bin=$(readlink -f "$bin")
source=$(readlink -f "$(dirname "$(readlink -f "$0")")/..")
mkdir -p "$out" "$work"

if [ "$part" = bundle ]; then
  mkdir -p "$out/bin" "$out/lib"
  for program in craftfleet craftfleet-torch device_check; do
    if [ -x "$bin/$program" ]; then install -s "$bin/$program" "$out/bin/"; fi
  done
  # glibc, C++ and LibTorch with what comes in its folder are there.
  libtorch=$(readlink -m "$out/lib/craftfleet/libtorch")
  ldd "$out"/bin/* | awk '$2 == "=>" && $3 ~ "^/" {print $3}' | sort -u |
    grep -vE '/(lib(c|m|mvec|dl|rt|pthread|util|resolv|anl|stdc\+\+|gcc_s)\.so|lib(torch|c10)[_.]|ld-linux)' |
    while read -r library; do
      [[ $(readlink -f "$library") == @("$libtorch"|*/nvidia)/* ]] || cp -Lt "$out/lib" "$library"
    done
  mkdir -p "$out/share/craftfleet"
  cp -r "$source/envserver/textures" "$out/share/craftfleet/"
  du -sh "$out"
  exit 0
fi

# A bundle brings all libraries but LibTorch, for which its programs look there.
export LD_LIBRARY_PATH=$bin/../lib${LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH}
torch=$(python3 -c 'import importlib.util as u; print(*u.find_spec("torch").submodule_search_locations)' 2>/dev/null || true)
if [[ -n $torch && ! -e $bin/../lib/craftfleet/libtorch ]]; then
  mkdir -p "$bin/../lib/craftfleet"
  ln -s "$torch/lib" "$bin/../lib/craftfleet/libtorch"
fi
[ -n "$seconds" ] || { [ "$part" = a ] && seconds=300 || seconds=450; }
end=$((SECONDS + seconds))
failed=0

# Arguments: name, limit in seconds, command. Does nothing if less than a second is left.
step() {
  local name=$1 limit=$2 begin=$SECONDS code=0
  shift 2
  [ "$limit" -lt $((end - SECONDS)) ] || limit=$((end - SECONDS))
  if [ "$limit" -lt 1 ]; then
    echo "$name: left out, $seconds s are over" | tee -a "$out/steps.txt"
    return 0
  fi
  timeout --kill-after=5 "$limit" "$@" >"$out/$name.log" 2>&1 || code=$?
  [ "$code" -ne 124 ] || echo "gpu_session.sh: stopped after $limit s" >>"$out/$name.log"
  echo "$name: exit code $code after $((SECONDS - begin)) of $limit s" | tee -a "$out/steps.txt"
  [ "$code" -eq 0 ] || failed=$((failed + 1))
  return "$code"
}

# Arguments: agent, steps, episodes of the final evaluation, more fields. Prints a configuration without other evaluations, and
# with one checkpoint.
config() {
  local agent=$1 steps=$2 episodes=$3 more=${4:-}
  if [ -n "$small" ]; then
    local size=40
    [ "$agent" != oc_sa ] || size=20
    steps=64 episodes=$((episodes > 0))
    more="lanes: 4 fragment_steps: 16 env { length: 20 } ppo { rollout_steps: 64 minibatch_size: 32 epochs: 1 } network { frame_size: $size }"
  fi
  echo "agent: '$agent' steps: $steps seed: 1 checkpoint { every_iterations: 1000 } eval { every_steps: 0 final_episodes: $episodes } $more"
}
train=("$bin/craftfleet" train --device="$device")
check=("$bin/device_check" --device="$device")
precision=''
if [ "$device" = cpu ]; then
  check+=(--precisions=FP32)
else
  precision="precision: TF32"
fi
agents=()
iterations=6
profiled=ppo_cnn,lstm_cnn,oc_sa
small_config=''
if [ -n "$small" ]; then
  small_config="network { frame_size: 40 } ppo { epochs: 1 }"
  iterations=2
  profiled=ppo_cnn
  check+=(--small)
  agents=(--agents=ppo_cnn)
fi

if [ "$part" = a ]; then
  [ ! -e "$work/oc_sa.pid" ] || refuse "--work=$work: has a run already; stop it and remove the folder"
  step machine 10 lscpu || true
  [ "$device" = cpu ] || step gpu 10 nvidia-smi -q || true
  step doctor 20 "$bin/craftfleet" doctor || true
  config ppo_cnn 12288 0 >"$out/smoke.txt"
  step smoke 60 "${train[@]}" --config="$out/smoke.txt" --logdir="$work/smoke" ||
    step smoke-blocking 60 env CUDA_LAUNCH_BLOCKING=1 "${train[@]}" --config="$out/smoke.txt" --logdir="$work/blocking" || true
  step check 110 "${check[@]}" "${agents[@]}" --checks="update,act,repeat,speed" || true
  step memory 20 "${check[@]}" --agents=ppo_cnn --checks=memory || true
  mkdir -p "$out/profiles"
  step profile 40 "${check[@]}" --agents="$profiled" --checks=profile --profile="$out/profiles" || true
  bench=("$source/tests/bench/train/device_bench.py" --bin="$bin" --device="$device")
  for wanted in false true; do  # the weights are to be the same
    step "acting_stream_$wanted" 20 python3 "${bench[@]}" --agents=ppo_cnn --iterations="$iterations" \
      --config="overlap: 1 acting_stream: $wanted $small_config" --out="$out/acting_stream.jsonl" || true
  done
  loops=("${bench[@]}" --iterations=3 --run_limit=40 --config="$small_config"
    --limit=$((end - SECONDS - 5)) --logs="$out/loops" --out="$out/loops.jsonl" "${agents[@]}")
  [ "$device" = cpu ] || loops+=("--precisions=TF32,BF16")
  step loops "$((end - SECONDS))" python3 "${loops[@]}" || true
  # Last, since it takes a part of the GPU.
  config oc_sa 1000000 100 "$precision" >"$work/oc_sa.txt"
  setsid "${train[@]}" --config="$work/oc_sa.txt" --logdir="$work/oc_sa" >"$work/oc_sa.log" 2>&1 </dev/null &
  echo $! >"$work/oc_sa.pid"
  sleep 2
  if kill -0 $! 2>/dev/null; then
    echo "oc_sa: runs" | tee -a "$out/steps.txt"
  elif ! wait $!; then
    echo "oc_sa: has failed, see $work/oc_sa.log" | tee -a "$out/steps.txt"
    failed=$((failed + 1))
  fi
else
  [ -r "$work/oc_sa.pid" ] || refuse "--work=$work: no run of OC-SA there; part a starts it"
  step oc_sa "$((seconds - 100))" tail --pid="$(cat "$work/oc_sa.pid")" -f /dev/null || true
  mkdir -p "$out/oc_sa"
  find "$work" -maxdepth 1 -name 'oc_sa.*' -exec cp -t "$out/oc_sa" {} +
  if [ -d "$work/oc_sa" ]; then find "$work/oc_sa" -maxdepth 1 -type f -exec cp -t "$out/oc_sa" {} +; fi
  weights=("$work"/oc_sa/checkpoints/*/weights.safetensors)
  step weights 10 cp "${weights[-1]}" "$out/oc_sa" || true
  config ppo_cnn 1000000 0 >"$out/ppo_cnn.txt"
  step ppo_cnn "$((end - SECONDS))" "${train[@]}" --config="$out/ppo_cnn.txt" --logdir="$out/ppo_cnn" || true
fi
echo "part $part: $failed steps failed"
[ "$failed" -eq 0 ]
