#!/usr/bin/env bash
# Runs the tests under AddressSanitizer and UndefinedBehaviorSanitizer, then those of targets that link neither gRPC nor
# LibTorch under ThreadSanitizer, but for the goldens. Installs and builds what is missing; reports like deploy/test.sh.
#
# Usage: tests/sanitizers.sh [CTEST ARGUMENT]...

set -euo pipefail
exec "$(dirname "$0")/../deploy/test.sh" --suites=asan-ubsan,tsan "$@"
