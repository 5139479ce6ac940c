#!/bin/sh
# Runs the program with the same name in ../libexec of a bundle, with the LibTorch of this machine. CRAFTFLEET_LIBTORCH
# selects it (an unpacked LibTorch, a Python environment with torch, its site-packages, or the folder of libtorch.so);
# otherwise it is that of the python3 in PATH. deploy/bundle.sh puts a copy into bin/ for each program that needs LibTorch.

set -eu

self=$(readlink -f "$0")
name=$(basename "$self")
root=$(dirname "$(dirname "$self")")
# Sets LIBTORCH_VERSION, against which the programs were built, and GLIBC_VERSION, the oldest that they run on.
# shellcheck source=/dev/null
. "$root/lib/craftfleet/bundle.env"

fail() {
  echo "$name: $*" >&2
  exit 1
}

# Prints the folder of libtorch.so in or under $1; fails if there is none.
library_folder() {
  for dir in "$1" "$1/lib" "$1/libtorch/lib" "$1/torch/lib" "$1"/lib/python3*/site-packages/torch/lib \
    "$1"/lib64/python3*/site-packages/torch/lib "$1"/lib/python3*/dist-packages/torch/lib; do
    for file in "$dir"/libtorch_cpu.so*; do
      if [ -e "$file" ]; then
        echo "$dir"
        return 0
      fi
    done
  done
  return 1
}

# Prints "major.minor" of the LibTorch in folder $1, from the files of a wheel, an archive or a distribution; nothing if unknown.
version_in() {
  if [ -r "$1/../version.py" ]; then
    sed -n "s/^__version__ = '\([0-9]*\.[0-9]*\).*/\1/p" "$1/../version.py"
  elif [ -r "$1/../build-version" ]; then
    sed -n '1s/^\([0-9]*\.[0-9]*\).*/\1/p' "$1/../build-version"
  else
    for file in "$1"/libtorch_cpu.so.*; do echo "$file"; done | sed -n 's/.*\.so\.\([0-9]*\.[0-9]*\)$/\1/p' | head -n 1
  fi
}

glibc=$(getconf GNU_LIBC_VERSION 2>/dev/null | sed -n 's/^glibc //p')
if [ -n "$glibc" ] && [ "$(printf '%s\n' "$GLIBC_VERSION" "$glibc" | sort -V | head -n 1)" != "$GLIBC_VERSION" ]; then
  fail "this system has glibc $glibc, want $GLIBC_VERSION or newer"
fi

how="activate a Python environment with torch $LIBTORCH_VERSION (pip install 'torch==$LIBTORCH_VERSION.*'), or set CRAFTFLEET_LIBTORCH to the folder of a LibTorch $LIBTORCH_VERSION"
if [ -n "${CRAFTFLEET_LIBTORCH:-}" ]; then
  libraries=$(library_folder "$CRAFTFLEET_LIBTORCH") || fail "CRAFTFLEET_LIBTORCH=$CRAFTFLEET_LIBTORCH: no LibTorch there; $how"
else
  # Finds the folder of torch without importing it, which takes seconds. A torch in the current folder is not meant.
  package=$(python3 -c 'import sys; sys.path = [p for p in sys.path if p]
import importlib.util as u; s = u.find_spec("torch"); print(s.submodule_search_locations[0] if s else "")' 2>/dev/null) || package=
  [ -n "$package" ] || fail "no LibTorch: python3 has no torch; $how"
  libraries=$(library_folder "$package") || fail "no LibTorch in $package/lib; $how"
fi
version=$(version_in "$libraries")
[ "$version" = "$LIBTORCH_VERSION" ] || fail "LibTorch in $libraries is ${version:-of unknown version}, want $LIBTORCH_VERSION; $how"

# The bundle's libraries come first: libraries with a RUNPATH ignore the RPATH of the program.
LD_LIBRARY_PATH=$root/lib/craftfleet:$libraries${LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH}
export LD_LIBRARY_PATH
exec "$root/libexec/$name" "$@"
