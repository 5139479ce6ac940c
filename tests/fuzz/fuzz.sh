#!/usr/bin/env bash
# Searches for inputs that break the parsers of untrusted data (messages, configurations, checkpoints, snapshots, logs,
# textures, weights) with libFuzzer under AddressSanitizer and UndefinedBehaviorSanitizer. Starts from the inputs in
# tests/fuzz/corpus/TARGET.tar.gz and tests/fuzz/regressions/TARGET; inputs that reach new code are kept in build-fuzz/corpus
# for the next search.
#
# Usage: tests/fuzz/fuzz.sh [--inputs=N] [--keep] [TARGET]...
#   --inputs=N  inputs to try for each target; default 120000
#   --keep      then replace the archive in tests/fuzz/corpus by the fewest inputs that reach the same code
#   TARGET      like world_snapshot; default: every tests/fuzz/fuzz_TARGET.cc
# The last line is `N targets without a finding, N with one`; exit 1 if there is one. A finding is written to
# build-fuzz/findings; build-fuzz/bin/fuzz_TARGET FILE reproduces it. Once its cause is fixed, it belongs in
# tests/fuzz/regressions/TARGET under a descriptive name.

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
cd "$(dirname "$(readlink -f "$0")")/../.."
if [ ${#targets[@]} -eq 0 ]; then
  for source in tests/fuzz/fuzz_*.cc; do
    name=${source##*/fuzz_}
    targets+=("${name%.cc}")
  done
fi

programs=()
for target in "${targets[@]}"; do programs+=("fuzz_$target" "fuzz_${target}_replay"); done
deploy/install-deps.sh --developer
cmake --preset fuzz
cmake --build --preset fuzz --parallel "${JOBS:-$(env -u OMP_NUM_THREADS -u OMP_THREAD_LIMIT nproc)}" --target "${programs[@]}"

findings=$PWD/build-fuzz/findings
mkdir -p "$findings"
sound=0
broken=0
for target in "${targets[@]}"; do
  corpus=build-fuzz/corpus/$target
  archive=tests/fuzz/corpus/$target.tar.gz
  known=build-fuzz/known/$target
  mkdir -p "$corpus"
  rm -rf "$known"
  build-fuzz/bin/"fuzz_${target}_replay" --write_seeds "$known" >/dev/null
  if [ -f "$archive" ]; then tests/fuzz/corpus.sh unpack "$archive" "$known"; fi
  if [ -d "tests/fuzz/regressions/$target" ]; then cp "tests/fuzz/regressions/$target"/* "$known"; fi
  log=build-fuzz/fuzz_$target.log
  if build-fuzz/bin/"fuzz_$target" -runs="$inputs" -max_len=65536 -timeout=20 -rss_limit_mb=4096 -print_final_stats=1 \
      -artifact_prefix="$findings/$target-" "$corpus" "$known" >"$log" 2>&1; then
    sound=$((sound + 1))
    echo "$target: $(sed -n 's/^stat::number_of_executed_units: *//p' "$log") inputs, no finding"
    if [ -n "$keep" ]; then
      kept=build-fuzz/kept/$target
      rm -rf "$kept"
      mkdir -p "$kept"
      build-fuzz/bin/"fuzz_$target" -set_cover_merge=1 -max_len=65536 "$kept" "$known" "$corpus" >"$log.merge" 2>&1
      tests/fuzz/corpus.sh pack "$archive" "$kept"
    fi
  else
    broken=$((broken + 1))
    echo "$target: a finding; the end of $log:"
    grep -E 'SUMMARY|broken invariant|Test unit written' "$log" || tail -5 "$log"
  fi
done
echo "$sound targets without a finding, $broken with one"
[ "$broken" -eq 0 ]
