#!/usr/bin/env bash
# Runs the README's two commands in a bare root of a distribution: makes the root with mmdebstrap, puts a clean checkout of HEAD
# into it, runs deploy/quickstart.sh and deploy/test.sh, prints the versions of the packages, and removes the root. Must run as
# root, and needs access to a mirror of the distribution. Takes about an hour on two cores without a ccache.
#
# Usage: deploy/try-distro.sh SUITE [--quick] [--mirror=URL] [--ccache=DIR] [--dir=DIR] [--keep]
#   SUITE         bookworm (Debian 12) or trixie (Debian 13)
#   --quick       only deploy/quickstart.sh --steps=8192
#   --mirror=URL  mirror of the packages; default: mmdebstrap's for the suite
#   --ccache=DIR  folder of a ccache, kept for the next time
#   --dir=DIR     folder to make the root in; needs 12 GB; default: /var/tmp
#   --keep        do not remove the root, and print its path
#   JOBS          environment variable: parallel compilers, as for deploy/build.sh

set -euo pipefail

usage() { sed -n '2,/^$/s/^# \{0,1\}//p' "$0"; }
refuse() { echo "try-distro.sh: $*" >&2; exit 2; }

suite='' quick='' mirror='' ccache='' dir=/var/tmp keep=''
for argument in "$@"; do
  case "$argument" in
    -h | --help) usage; exit 0 ;;
    --quick) quick=yes ;;
    --mirror=?*) mirror=${argument#*=} ;;
    --ccache=?*) ccache=${argument#*=} ;;
    --dir=?*) dir=${argument#*=} ;;
    --keep) keep=yes ;;
    -*) refuse "unknown argument '$argument'; see --help" ;;
    *) [ -z "$suite" ] || refuse "'$argument' after '$suite': want one suite"; suite=$argument ;;
  esac
done
case "$suite" in
  bookworm | trixie) ;;
  *) refuse "SUITE='$suite', want bookworm or trixie" ;;
esac
[ "$(id -u)" -eq 0 ] || refuse "needs root"
for tool in mmdebstrap git unshare; do
  command -v "$tool" >/dev/null || refuse "$tool is not installed"
done

# In a mount namespace of its own: the mounts are private to this script and end with it.
if [ -z "${TRY_DISTRO_UNSHARED:-}" ]; then
  TRY_DISTRO_UNSHARED=yes exec unshare --mount --propagation private "$0" "$@"
fi

source=$(readlink -f "$(dirname "$(readlink -f "$0")")/..")
root=$(mktemp -d "$dir/craftfleet-$suite.XXXXXX")
mount --bind "$root" "$root"  # tests make mount namespaces, for which / must be a mount
mounted=("$root")
# shellcheck disable=SC2317  # the trap calls it
clean_up() {
  local mounts
  for ((i = ${#mounted[@]} - 1; i >= 0; i--)); do umount --recursive --lazy "${mounted[$i]}" || true; done
  mounts=$(findmnt --list --noheadings --output TARGET || echo "$root")
  if [ -n "$keep" ]; then
    echo "try-distro.sh: the root is $root"
  elif [[ $mounts == *"$root"* ]]; then  # rm would empty the folders that are mounted there
    echo "try-distro.sh: still mounted, not removed: $root" >&2
  else
    rm -rf --one-file-system "$root"
  fi
}
trap clean_up EXIT
bind() {
  mkdir -p "$root/$2"
  mount --rbind "$1" "$root/$2"
  mount --make-rslave "$root/$2"
  mounted+=("$root/$2")
}

# apt in the root checks an https mirror against ca-certificates.
include=()
[[ $mirror != https:* ]] || include=(--include=ca-certificates)
mmdebstrap --quiet --variant=minbase "${include[@]}" "$suite" "$root" ${mirror:+"$mirror"}
git clone --quiet --no-hardlinks "$source" "$root/src"
git -C "$root/src" remote remove origin
cp /etc/resolv.conf "$root/etc/resolv.conf"
[ -e "$root/etc/hosts" ] || printf '127.0.0.1 localhost\n::1 localhost\n' >"$root/etc/hosts"  # every machine has one
for folder in proc sys dev; do bind "/$folder" "$folder"; done

variables=(HOME=/root PATH=/usr/sbin:/usr/bin:/sbin:/bin LANG=C.UTF-8)
for name in JOBS http_proxy https_proxy no_proxy; do
  [ -z "${!name:-}" ] || variables+=("$name=${!name}")
done
inside() { chroot "$root" env --chdir=/src -i "${variables[@]}" "$@"; }
if [ -n "$ccache" ]; then
  mkdir -p "$ccache"
  bind "$ccache" ccache
  inside apt-get update -qq
  inside env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends ccache >/dev/null
  variables+=(CCACHE_DIR=/ccache CMAKE_C_COMPILER_LAUNCHER=ccache CMAKE_CXX_COMPILER_LAUNCHER=ccache)
fi

result=0
if [ -n "$quick" ]; then
  inside deploy/quickstart.sh --steps=8192 || result=1
else
  inside deploy/quickstart.sh && inside deploy/test.sh || result=1
fi
echo "try-distro.sh: $suite, commit $(git -C "$source" rev-parse --short HEAD):"
# shellcheck disable=SC2016  # dpkg-query expands it
inside dpkg-query --show --showformat='  ${Package} ${Version}\n' g++ cmake libtorch-dev libgrpc++-dev libprotobuf-dev libabsl-dev \
  libopencv-core-dev || result=1
if [ "$result" -eq 0 ]; then echo "try-distro.sh: $suite passed"; else echo "try-distro.sh: $suite FAILED"; fi
exit "$result"
