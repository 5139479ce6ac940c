#!/usr/bin/env bash
# Installs what is missing, builds release, runs every test. The last line says "N passed, N failed", with ", N skipped"
# where tests were skipped. Fails when a test failed or none ran.
#
# Usage: deploy/test.sh [CTEST ARGUMENT]...
#   deploy/test.sh -L unit     only tests with a label: unit, golden, property, integration, bench, tsan
#   deploy/test.sh -R World    only tests whose name has "World" in it
#   CRAFTFLEET_GOLDEN_DIR      environment variable: folder with the golden files; without it their tests are skipped

set -euo pipefail

usage() { sed -n '2,/^$/s/^# \{0,1\}//p' "$0"; }
case "${1:-}" in
  -h | --help) usage; exit 0 ;;
esac
cd "$(dirname "$0")/.."

deploy/install-deps.sh
deploy/build.sh release

results=$PWD/build/test-results.xml
rm -f "$results"
ctest_failed=0
ctest --test-dir build --output-on-failure --parallel "$(nproc)" --output-junit "$results" "$@" || ctest_failed=1

count() { grep -cE "$1" "$results" || true; }
total=0 passed=0 skipped=0
if [ -f "$results" ]; then
  total=$(count '<testcase ')
  passed=$(count '<testcase .*status="run"')
  # A test whose program is missing is marked as skipped too, with another message: that one has failed.
  skipped=$(count 'status="disabled"|<skipped message="SKIP_')
fi
failed=$((total - passed - skipped))
if [ "$ctest_failed" -ne 0 ] && [ "$failed" -eq 0 ]; then
  echo "test.sh: ctest failed before it could run the tests" >&2
  failed=1
fi
if [ $((passed + failed)) -eq 0 ]; then
  echo "test.sh: no test ran" >&2
  ctest_failed=1
fi

summary="$passed passed, $failed failed"
[ "$skipped" -eq 0 ] || summary+=", $skipped skipped"
echo "$summary"
[ "$failed" -eq 0 ] && [ "$ctest_failed" -eq 0 ]
