#!/usr/bin/env bash
# Installs missing packages, builds, runs every test. The last line is "N passed, N failed", with ", N skipped" if
# tests were skipped. Fails if a test failed or none ran.
#
# Usage: deploy/test.sh [--suites=PRESET,...] [CTEST ARGUMENT]...
#   --suites=PRESET,...        presets to build and test in turn: release (default), ci (with warnings as errors), debug,
#                              asan-ubsan, asan-ubsan-unit, tsan, libtorch-cuda-unit; see CMakePresets.json
#   deploy/test.sh -L unit     only tests with a label: unit, golden, property, integration, tsan, slow
#   deploy/test.sh -R World    only tests whose name has "World" in it
#   CRAFTFLEET_GOLDEN_DIR      environment variable: folder with the golden files; without it their tests are skipped

set -euo pipefail

usage() { sed -n '2,/^$/s/^# \{0,1\}//p' "$0"; }
suites=release
case "${1:-}" in
  -h | --help) usage; exit 0 ;;
  --suites=*) suites=${1#*=}; shift ;;
esac
cd "$(dirname "$(readlink -f "$0")")/.."

passed=0 failed=0 skipped=0

# Arguments: a failure that no test reports. It counts as a failed test.
add_failure() {
  echo "test.sh: $*" >&2
  failed=$((failed + 1))
}

# The build folder of a preset.
folder() { if [[ $1 == release || $1 == ci ]]; then echo build; else echo "build-$1"; fi; }

# Builds a preset while the tests of another run, which mostly wait. They have deadlines, so it gets only the CPU time that they
# leave: Linux weighs sessions against each other whatever the nice values in them, hence the autogroup.
beside=
build_beside() {
  echo "Building $1 beside the tests."
  mkdir -p "$(folder "$1")"
  # shellcheck disable=SC2016  # the inner shell expands it
  setsid nice -n 19 bash -c '{ echo 19 >/proc/self/autogroup; } 2>/dev/null; exec "$@"' - \
    deploy/build.sh "$1" "${settings[@]}" >"$(folder "$1")/build.log" 2>&1 &
  beside=$!
}
trap '[ -z "$beside" ] || kill -- "-$beside"' EXIT

# Runs the tests of a build and adds up their results. Arguments: its preset, then arguments of ctest.
run_suite() {
  local preset=$1 results ctest_failed=0
  shift
  results=$PWD/$(folder "$preset")/test-results.xml
  rm -f "$results"
  # GDAL, a dependency of OpenCV, takes its locks in varying order. Races are still reported.
  [ "$preset" != tsan ] || export TSAN_OPTIONS=detect_deadlocks=0
  # One more than there are CPUs: many tests wait for deadlines of the fleets that they run.
  ctest --preset "$preset" --parallel "$(($(env -u OMP_NUM_THREADS -u OMP_THREAD_LIMIT nproc) + 1))" --output-junit "$results" --test-output-size-passed 1000000 \
    --test-output-truncation middle "$@" || ctest_failed=1
  if ! [ -f "$results" ]; then
    add_failure "$preset: ctest could not run the tests"
    return
  fi

  count() { grep -cE "$1" "$results" || true; }
  local ran good bad left_out
  ran=$(count '<testcase ')
  good=$(count '<testcase .*status="run"')
  # ctest also marks tests as skipped whose program is missing, with another message. They count as failed.
  left_out=$(count 'status="disabled"|<skipped message="SKIP_')
  bad=$((ran - good - left_out))
  # Entries without a dot are programs, which say how many of their tests passed and name those that were skipped. A program
  # that fails counts once.
  if grep -q '^CRAFTFLEET_TEST_PROGRAMS:BOOL=ON' "${results%/*}/CMakeCache.txt"; then
    lines() { awk -v wanted="$1" '/<testcase name="/ {program = /name="[^".]*"/} program && $0 ~ wanted' "$results"; }
    sum() { lines "^[[]  $1 +[]] [0-9]+ test" | awk '{sum += $4} END {print sum + 0}'; }
    good=$((good - $(count '<testcase name="[^".]*".*status="run"') + $(sum PASSED)))
    left_out=$((left_out + $(sum SKIPPED)))
    lines '^[[]  SKIPPED []] [^ ]+$'
  fi
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
# Tests that are selected by name have ctest entries of their own; otherwise one runs many.
settings=(-DCRAFTFLEET_BUILD_TESTS=ON -DCRAFTFLEET_TEST_PROGRAMS=ON)
[ $# -eq 0 ] || settings[1]=-DCRAFTFLEET_TEST_PROGRAMS=OFF
IFS=, read -ra suites <<<"$suites"
for i in "${!suites[@]}"; do
  suite=${suites[$i]} next=${suites[$((i + 1))]:-}
  built=yes
  if [ -n "$beside" ]; then
    wait "$beside" || built=
    beside=
    cat "$(folder "$suite")/build.log"
  else
    deploy/build.sh "$suite" "${settings[@]}" || built=
  fi
  if [ -n "$next" ] && [ "$(folder "$next")" != "$(folder "$suite")" ]; then build_beside "$next"; fi
  if [ -n "$built" ]; then
    run_suite "$suite" "$@"
  else
    add_failure "$suite does not build"
  fi
done

summary="$passed passed, $failed failed"
[ "$skipped" -eq 0 ] || summary+=", $skipped skipped"
echo "$summary"
[ "$failed" -eq 0 ] && [ $((passed + skipped)) -gt 0 ]
