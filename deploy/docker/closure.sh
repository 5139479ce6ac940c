#!/usr/bin/env bash
# Makes a root file system for programs: the programs in /usr/local/bin, their shared libraries at the same paths as on this
# system, and an unprivileged user. No shell.
#
# Usage: deploy/docker/closure.sh DIR PREFIX PROGRAM...
#   DIR      is created if it does not exist; must be empty
#   PREFIX   the folder with bin/PROGRAM: an installation, or build/
#   PROGRAM  such as craftfleet-envserver

set -euo pipefail

usage() { sed -n '2,/^$/s/^# \{0,1\}//p' "$0"; }
if [ $# -lt 3 ]; then usage >&2; exit 2; fi
dir=$1
prefix=$2
shift 2
mkdir -p "$dir"
if [ -n "$(ls -A "$dir")" ]; then echo "closure.sh: $dir is not empty" >&2; exit 2; fi

mkdir -p "$dir"/{etc,tmp,usr/local/bin,usr/bin,usr/sbin,usr/lib,usr/lib64}
for name in bin sbin lib lib64; do ln -s "usr/$name" "$dir/$name"; done
for program in "$@"; do
  install -m 755 "$prefix/bin/$program" "$dir/usr/local/bin/"
  missing=$(ldd "$prefix/bin/$program" | awk '/not found/ {print $1}')
  if [ -n "$missing" ]; then echo "closure.sh: $program needs $missing, which is not installed" >&2; exit 1; fi
done
# Copies each library under the name that the loader looks for, with the content of the file that it links to.
for program in "$@"; do ldd "$prefix/bin/$program"; done |
  awk '$2 == "=>" {print $3} $1 ~ /^\// {print $1}' | sort -u |
  while read -r library; do
    to=$dir$(realpath "$(dirname "$library")")/$(basename "$library")
    mkdir -p "$(dirname "$to")"
    cp -L "$library" "$to"
  done
echo "craftfleet:x:10001:10001::/:/" >"$dir/etc/passwd"
echo "craftfleet:x:10001:" >"$dir/etc/group"
chmod 1777 "$dir/tmp"
