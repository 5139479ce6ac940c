#!/usr/bin/env bash
# Searches for inputs that break what reads bytes from outside (messages, configurations, checkpoints, snapshots, logs,
# textures, weights) with libFuzzer under AddressSanitizer and UndefinedBehaviorSanitizer. Begins with tests/fuzz/corpus;
# what it finds on the way is kept in build-fuzz/corpus and used the next time.
#
# Usage: deploy/fuzz.sh [--inputs=N] [--keep] [TARGET]...
#   --inputs=N  inputs to try for each target; default 120000
#   --keep      then add to tests/fuzz/corpus the fewest inputs that reach all that was reached, for the tests
#   TARGET      like world_snapshot; default: every tests/fuzz/fuzz_TARGET.cc
# The last line is `N targets without a finding, N with one`; exit 1 if there is one. A finding is left in
# build-fuzz/findings; build-fuzz/bin/fuzz_TARGET FILE tries it again.

set -euo pipefail

usage() { sed -n '2,/^$/s/^# \{0,1\}//p' "$0"; }
inputs=120000
keep=
targets=()
for argument in "$@"; do
  case "$argument" in
    -h | --help) usage; exit 0 ;;
    --inputs=*) inputs=${argument#*=} ;;
    --keep) keep=1 ;;
    -*) echo "fuzz.sh: unknown argument '$argument'" >&2; usage >&2; exit 2 ;;
    *) targets+=("$argument") ;;
  esac
done
cd "$(dirname "$0")/.."
if [ ${#targets[@]} -eq 0 ]; then
  for source in tests/fuzz/fuzz_*.cc; do
    name=${source##*/fuzz_}
    targets+=("${name%.cc}")
  done
fi

deploy/install-deps.sh --developer
cmake --preset fuzz
cmake --build --preset fuzz --parallel "${JOBS:-$(nproc)}" --target "${targets[@]/#/fuzz_}"

findings=$PWD/build-fuzz/findings
mkdir -p "$findings"
sound=0
broken=0
for target in "${targets[@]}"; do
  corpus=build-fuzz/corpus/$target
  mkdir -p "$corpus"
  log=build-fuzz/fuzz_$target.log
  if build-fuzz/bin/"fuzz_$target" -runs="$inputs" -max_len=65536 -timeout=20 -rss_limit_mb=4096 -print_final_stats=1 \
      -artifact_prefix="$findings/$target-" "$corpus" "tests/fuzz/corpus/$target" >"$log" 2>&1; then
    sound=$((sound + 1))
    echo "$target: $(sed -n 's/^stat::number_of_executed_units: *//p' "$log") inputs, no finding"
    if [ -n "$keep" ]; then
      build-fuzz/bin/"fuzz_$target" -set_cover_merge=1 -max_len=65536 "tests/fuzz/corpus/$target" "$corpus" >"$log.merge" 2>&1
    fi
  else
    broken=$((broken + 1))
    echo "$target: a finding; the end of $log:"
    grep -E 'SUMMARY|broken invariant|Test unit written' "$log" || tail -5 "$log"
  fi
done
echo "$sound targets without a finding, $broken with one"
[ "$broken" -eq 0 ]
