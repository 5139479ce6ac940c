#!/usr/bin/env bash
# Fills a folder with what programs need to run there as the root of a file system: the programs in /usr/local/bin with their
# data in /usr/local/share/craftfleet, their shared libraries where this system has them, and an unprivileged user. No shell.
#
# Usage: deploy/docker/closure.sh DIR PREFIX PROGRAM...
#   DIR      is made; must be empty
#   PREFIX   where bin/PROGRAM and share/craftfleet lie: an installation, or build/
#   PROGRAM  like craftfleet-envserver

set -euo pipefail

usage() { sed -n '2,/^$/s/^# \{0,1\}//p' "$0"; }
if [ $# -lt 3 ]; then usage >&2; exit 2; fi
dir=$1
prefix=$2
shift 2
mkdir -p "$dir"
if [ -n "$(ls -A "$dir")" ]; then echo "closure.sh: $dir is not empty" >&2; exit 2; fi

mkdir -p "$dir"/{etc,tmp,usr/local/bin,usr/local/share/craftfleet,usr/bin,usr/sbin,usr/lib,usr/lib64}
for name in bin sbin lib lib64; do ln -s "usr/$name" "$dir/$name"; done
cp -R "$prefix/share/craftfleet/textures" "$dir/usr/local/share/craftfleet/"
for program in "$@"; do
  install -m 755 "$prefix/bin/$program" "$dir/usr/local/bin/"
  missing=$(ldd "$prefix/bin/$program" | awk '/not found/ {print $1}')
  if [ -n "$missing" ]; then echo "closure.sh: $program wants $missing" >&2; exit 1; fi
done
# Library names as the loader asks for them, each with the content that its link leads to.
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
