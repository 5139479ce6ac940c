#!/usr/bin/env bash
# Configures and builds the programs; the developers' presets also build the tests. The programs are in <build folder>/bin
# (build/bin for release).
#
# Usage: deploy/build.sh [PRESET] [-DNAME=VALUE]...
#   PRESET  release (default), ci, debug, asan-ubsan, asan-ubsan-unit, tsan or libtorch-cuda-unit: see CMakePresets.json
#   -DCRAFTFLEET_LIBTORCH=DIR  build against the LibTorch in DIR; later builds in the same folder remember it
#   -DCRAFTFLEET_BUILD_TESTS=ON  build the tests too; later builds in the same folder remember it
#   -DCRAFTFLEET_WERROR=ON     treat warnings as errors, as the developers' presets do; other compilers may give some
#   JOBS    environment variable: parallel compilers; default: one per core, fewer if memory is short

set -euo pipefail

usage() { sed -n '2,/^$/s/^# \{0,1\}//p' "$0"; }
preset=
settings=()
for argument in "$@"; do
  case "$argument" in
    -h | --help) usage; exit 0 ;;
    -D?*=*) settings+=("$argument") ;;
    -*) echo "build.sh: unknown argument '$argument'" >&2; usage >&2; exit 2 ;;
    *)
      [ -z "$preset" ] || { echo "build.sh: '$argument' after '$preset', want one preset" >&2; exit 2; }
      preset=$argument
      ;;
  esac
done
preset=${preset:-release}
cd "$(dirname "$(readlink -f "$0")")/.."

# A file that includes LibTorch takes up to 2 GB to compile.
memory_kib=$(awk '/^MemAvailable:/ {print $2}' /proc/meminfo)
if [ -r /sys/fs/cgroup/memory.max ] && [ "$(cat /sys/fs/cgroup/memory.max)" != max ]; then
  limit_kib=$(($(cat /sys/fs/cgroup/memory.max) / 1024))
  [ "$limit_kib" -ge "$memory_kib" ] || memory_kib=$limit_kib
fi
jobs=$(env -u OMP_NUM_THREADS -u OMP_THREAD_LIMIT nproc)
by_memory=$((memory_kib / (2 * 1024 * 1024)))
[ "$by_memory" -ge "$jobs" ] || jobs=$by_memory
[ "$jobs" -ge 1 ] || jobs=1

cmake --preset "$preset" "${settings[@]}"
cmake --build --preset "$preset" --parallel "${JOBS:-$jobs}"

build=build-$preset
[[ $preset != release && $preset != ci ]] || build=build
setting() { sed -n "s/^CRAFTFLEET_$1:[A-Z]*=//p" "$build/CMakeCache.txt"; }
libtorch=$(setting LIBTORCH_VERSION)
if [ -n "$libtorch" ]; then
  cuda="without CUDA"
  [ "$(setting LIBTORCH_CUDA)" != ON ] || cuda="with CUDA"
  echo "Built in $build, against LibTorch $libtorch $cuda: $(setting LIBTORCH_LIB_DIR)"
fi
