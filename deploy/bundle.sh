#!/usr/bin/env bash
# Makes an archive of a build that runs wherever it is unpacked, without root: programs, textures, experiments, and all
# shared libraries except glibc, LibTorch and those of LibTorch. Programs that need LibTorch find it when they start.
#
# Make the build with -DCRAFTFLEET_WITH_VIDEO=OFF -DCRAFTFLEET_WITH_WINDOW=OFF -DCRAFTFLEET_BUILD_TESTS=OFF: video needs more
# than a hundred libraries, and windows need Qt.
#
# Usage: deploy/bundle.sh [--build=DIR] [--out=DIR] [--level=N]
#   --build=DIR  a finished build; default: build
#   --out=DIR    folder for the archive, craftfleet-VERSION-linux-MACHINE[-cuda].tar.xz; default: the folder of the build
#   --level=N    compression level of xz, 0..9; default 9, which takes 700 MB of memory and some minutes

set -euo pipefail

usage() { sed -n '2,/^$/s/^# \{0,1\}//p' "$0"; }
refuse() { echo "bundle.sh: $*" >&2; exit 2; }

source=$(readlink -f "$(dirname "$(readlink -f "$0")")/..")
build=$source/build
out=
level=9
for argument in "$@"; do
  case "$argument" in
    -h | --help) usage; exit 0 ;;
    --build=?*) build=${argument#*=} ;;
    --out=?*) out=${argument#*=} ;;
    --level=[0-9]) level=${argument#*=} ;;
    *) refuse "unknown argument '$argument'; see --help" ;;
  esac
done
out=${out:-$build}
[ -r "$build/CMakeCache.txt" ] || refuse "--build=$build: no build there; see deploy/build.sh"
[ -x "$build/bin/craftfleet-train" ] || refuse "--build=$build: bin/craftfleet-train is not built"
for tool in cmake readelf ldd xz tar; do
  command -v "$tool" >/dev/null || refuse "$tool is not installed"
done

setting() { sed -n "s/^$1:[A-Z]*=//p" "$build/CMakeCache.txt"; }
libtorch_version=$(setting CRAFTFLEET_LIBTORCH_VERSION)
libtorch_dir=$(setting CRAFTFLEET_LIBTORCH_LIB_DIR)
[ -n "$libtorch_version" ] || refuse "--build=$build: this build has no LibTorch; want a complete build"
name=craftfleet-$(setting CMAKE_PROJECT_VERSION)-linux-$(uname -m)
[ "$(setting CRAFTFLEET_LIBTORCH_CUDA)" != ON ] || name+=-cuda

mkdir -p "$out"
stage=$(mktemp -d "$out/.bundle.XXXXXX")
trap 'rm -rf "$stage"' EXIT
root=$stage/$name
lib=$root/lib/craftfleet
cmake --install "$build" --prefix "$root" --strip >"$stage/install.log" || { cat "$stage/install.log" >&2; exit 1; }
rm -f "$lib/libtorch"  # the link to the LibTorch of this machine
mkdir -p "$root/libexec" "$lib"

# Libraries that are left out: those of LibTorch, and those of glibc, which must match the system's loader. libnsl.so.2 is
# not part of glibc.
of_libtorch() { [[ $1 =~ ^lib(torch|c10|caffe2) ]]; }
of_glibc() { [[ $1 =~ ^(ld-linux.*|lib(c|m|mvec|dl|pthread|rt|util|resolv|anl|thread_db|BrokenLocale|nss_.*))\.so|^libnsl\.so\.1 ]]; }
needed_by() { readelf -d "$1" | sed -n 's/.*(NEEDED).*\[\(.*\)\]/\1/p'; }

# The path of each library on this machine, and the libraries that programs need other than through LibTorch.
declare -A path_of=() taken=()
pending=()
is_binary() { readelf -h "$1" >/dev/null 2>&1; }  # unlike the commands in Python
for program in "$root"/bin/*; do
  is_binary "$program" || continue
  listing=$(LD_LIBRARY_PATH=$libtorch_dir ldd "$build/bin/$(basename "$program")")
  while read -r library arrow path _; do
    [ "$arrow" != "=>" ] || path_of[$library]=$path
  done <<<"$listing"
  pending+=("$program")
done
# OpenCV links a BLAS that is not used here. Unless LibTorch uses it, take the reference BLAS, a tenth of the size of OpenBLAS.
if [[ ! $(needed_by "$libtorch_dir/libtorch_cpu.so") =~ libblas ]]; then
  for library in blas lapack; do
    reference=$(dirname "${path_of[lib$library.so.3]:-/}")/$library/lib$library.so.3
    [ ! -e "$reference" ] || path_of[lib$library.so.3]=$reference
  done
fi
while [ ${#pending[@]} -gt 0 ]; do
  file=${pending[-1]}
  unset 'pending[-1]'
  for library in $(needed_by "$file"); do
    if of_libtorch "$library" || of_glibc "$library" || [ -n "${taken[$library]:-}" ]; then continue; fi
    [ -e "${path_of[$library]:-}" ] || { echo "bundle.sh: $(basename "$file") needs $library, which is not installed" >&2; exit 1; }
    taken[$library]=yes
    cp -L "${path_of[$library]}" "$lib/$library"
    chmod u+w "$lib/$library"
    pending+=("$lib/$library")
  done
done

for program in "$root"/bin/*; do
  is_binary "$program" || continue
  needed=$(needed_by "$program")
  [[ $needed =~ libtorch|libc10 ]] || continue
  mv "$program" "$root/libexec/"
  install -m 755 "$source/deploy/bundle-launcher.sh" "$program"
done
# readelf fails for the launchers, which are scripts.
glibc=$({ readelf -V "$root"/bin/* "$root"/libexec/* "$lib"/*.so* 2>/dev/null || true; } |
  grep -o 'GLIBC_[0-9.]*' | sort -uV | tail -n 1)
printf 'LIBTORCH_VERSION=%s\nGLIBC_VERSION=%s\n' "$libtorch_version" "${glibc#GLIBC_}" >"$lib/bundle.env"

filter=()
[ "$(uname -m)" != x86_64 ] || filter=(--x86)
tar -C "$stage" --sort=name --owner=0 --group=0 --numeric-owner -c "$name" |
  xz --threads=1 "${filter[@]}" --lzma2=preset="$level" >"$stage/archive"
mv "$stage/archive" "$out/$name.tar.xz"
echo "$out/$name.tar.xz: $(($(stat -c %s "$out/$name.tar.xz") / 1048576)) MiB, ${#taken[@]} libraries;" \
  "requires LibTorch $libtorch_version and glibc ${glibc#GLIBC_} or newer"
