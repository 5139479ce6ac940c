#!/usr/bin/env bash
# Installs what is missing, builds, runs every test. The last line says "N passed, N failed", with ", N skipped" where
# tests were skipped. Fails when a test failed or none ran.
#
# Usage: deploy/test.sh [--suites=PRESET,...] [CTEST ARGUMENT]...
#   --suites=PRESET,...        one after the other: release (default), debug, asan-ubsan, asan-ubsan-unit, tsan; see
#                              CMakePresets.json
#   deploy/test.sh -L unit     only tests with a label: unit, golden, property, integration, bench, tsan
#   deploy/test.sh -R World    only tests whose name has "World" in it
#   CRAFTFLEET_GOLDEN_DIR      environment variable: folder with the golden files; without it their tests are skipped

set -euo pipefail

usage() { sed -n '2,/^$/s/^# \{0,1\}//p' "$0"; }
suites=release
case "${1:-}" in
  -h | --help) usage; exit 0 ;;
  --suites=*) suites=${1#*=}; shift ;;
esac
cd "$(dirname "$0")/.."

passed=0 failed=0 skipped=0

# Arguments: what went wrong, although no test says so; counts as one that failed.
add_failure() {
  echo "test.sh: $*" >&2
  failed=$((failed + 1))
}

# Runs the tests of a build and adds up their results. Arguments: its preset, then ctest's.
run_suite() {
  local preset=$1 results=$PWD/build-$1/test-results.xml ctest_failed=0
  shift
  [ "$preset" != release ] || results=$PWD/build/test-results.xml
  rm -f "$results"
  # GDAL, which OpenCV brings, takes its own locks in either order; every race is still reported.
  [ "$preset" != tsan ] || export TSAN_OPTIONS=detect_deadlocks=0
  ctest --preset "$preset" --parallel "$(nproc)" --output-junit "$results" "$@" || ctest_failed=1
  if ! [ -f "$results" ]; then
    add_failure "$preset: ctest could not run the tests"
    return
  fi

  count() { grep -cE "$1" "$results" || true; }
  local ran good bad left_out
  ran=$(count '<testcase ')
  good=$(count '<testcase .*status="run"')
  # A test whose program is missing is marked as skipped too, with another message: that one has failed.
  left_out=$(count 'status="disabled"|<skipped message="SKIP_')
  bad=$((ran - good - left_out))
  echo "$preset: $good passed, $bad failed, $left_out skipped"
  passed=$((passed + good)) failed=$((failed + bad)) skipped=$((skipped + left_out))
  if [ $((good + bad)) -eq 0 ]; then
    add_failure "$preset: no test ran"
  elif [ "$ctest_failed" -ne 0 ] && [ "$bad" -eq 0 ]; then
    add_failure "$preset: ctest failed"
  fi
}

if [ "$suites" = release ]; then
  deploy/install-deps.sh --tests
else
  deploy/install-deps.sh --tests --developer
fi
for suite in ${suites//,/ }; do
  if deploy/build.sh "$suite"; then
    run_suite "$suite" "$@"
  else
    add_failure "$suite does not build"
  fi
done

summary="$passed passed, $failed failed"
[ "$skipped" -eq 0 ] || summary+=", $skipped skipped"
echo "$summary"
[ "$failed" -eq 0 ]
