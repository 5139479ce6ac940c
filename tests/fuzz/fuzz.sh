#!/usr/bin/env bash
# Searches for inputs that break the parsers of untrusted data (messages, configurations, checkpoints, snapshots, logs,
# textures, weights) with libFuzzer under AddressSanitizer and UndefinedBehaviorSanitizer. Starts from the inputs in
# tests/fuzz/corpus.tar.xz and tests/fuzz/regressions/TARGET; inputs that reach new code are kept in build-fuzz/corpus
# for the next search.
#
# Usage: tests/fuzz/fuzz.sh [--inputs=N] [--keep] [TARGET]...
#   --inputs=N  inputs to try for each target; default 120000
#   --keep      then replace the targets' inputs in corpus.tar.xz by the fewest that reach the same code
#   TARGET      like world_snapshot; default: all
# The last line is `N targets without a finding, N with one`; exit 1 if there is one. A finding is written to
# build-fuzz/findings; build-fuzz/bin/fuzz --target=TARGET FILE reproduces it. Once its cause is fixed, it belongs in
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

deploy/install-deps.sh --developer
cmake --preset fuzz
cmake --build --preset fuzz --parallel "${JOBS:-$(env -u OMP_NUM_THREADS -u OMP_THREAD_LIMIT nproc)}" --target fuzz fuzz_replay

findings=$PWD/build-fuzz/findings
known=build-fuzz/known
archived=build-fuzz/archived
rm -rf "$known" "$archived"
mkdir -p "$findings" "$known" "$archived"
tar -xJf tests/fuzz/corpus.tar.xz -C "$archived" --no-same-owner
build-fuzz/bin/fuzz_replay --write_seeds "$known"
cp -r "$archived"/. tests/fuzz/regressions/. "$known"
if [ ${#targets[@]} -eq 0 ]; then mapfile -t targets < <(ls "$known"); fi

for target in "${targets[@]}"; do
  [ -d "$known/$target" ] || { echo "fuzz.sh: no target '$target', want one of: $(cd "$known" && echo *)" >&2; exit 2; }
done
sound=0
broken=0
for target in "${targets[@]}"; do
  corpus=build-fuzz/corpus/$target
  mkdir -p "$corpus"
  log=build-fuzz/fuzz_$target.log
  if build-fuzz/bin/fuzz --target="$target" -runs="$inputs" -max_len=65536 -timeout=20 -rss_limit_mb=4096 -print_final_stats=1 \
      -artifact_prefix="$findings/$target-" "$corpus" "$known/$target" >"$log" 2>&1; then
    sound=$((sound + 1))
    echo "$target: $(sed -n 's/^stat::number_of_executed_units: *//p' "$log") inputs, no finding"
    if [ -n "$keep" ]; then
      rm -rf "${archived:?}/$target"
      mkdir -p "$archived/$target"
      build-fuzz/bin/fuzz --target="$target" -set_cover_merge=1 -max_len=65536 "$archived/$target" "$known/$target" "$corpus" \
        >"$log.merge" 2>&1
    fi
  else
    broken=$((broken + 1))
    echo "$target: a finding; the end of $log:"
    grep -E 'SUMMARY|broken invariant|Test unit written' "$log" || tail -5 "$log"
  fi
done
if [ -n "$keep" ]; then  # the same inputs always make the same archive
  (cd "$archived" && find . -type f -printf '%P\n' | LC_ALL=C sort |
    tar --create --format=ustar --mtime=@0 --owner=0 --group=0 --numeric-owner --mode=0644 --files-from=-) | xz -9e -T1 >build-fuzz/corpus.tar.xz
  mv build-fuzz/corpus.tar.xz tests/fuzz/corpus.tar.xz
fi
echo "$sound targets without a finding, $broken with one"
[ "$broken" -eq 0 ]
