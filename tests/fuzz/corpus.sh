#!/usr/bin/env bash
# Packs the corpus of a fuzz target into one archive, or unpacks it. The same inputs always make the same archive.
#
# Usage: tests/fuzz/corpus.sh pack|unpack ARCHIVE.tar.gz FOLDER
#   pack    writes ARCHIVE from the files in FOLDER
#   unpack  creates FOLDER and writes the files of ARCHIVE into it

set -euo pipefail

usage() { sed -n '2,/^$/s/^# \{0,1\}//p' "$0"; }
if [ "${1-}" = -h ] || [ "${1-}" = --help ]; then usage; exit 0; fi
if [ $# -ne 3 ]; then usage >&2; exit 2; fi
case $1 in
  pack)
    (cd "$3" && find . -type f -printf '%f\n' | LC_ALL=C sort |
      tar --create --format=ustar --mtime=@0 --owner=0 --group=0 --numeric-owner --mode=0644 --files-from=-) | gzip -9 -n >"$2.new"
    mv "$2.new" "$2"
    ;;
  unpack)
    mkdir -p "$3"
    tar --extract --gzip --file="$2" --directory="$3" --no-same-owner
    ;;
  *) echo "corpus.sh: '$1', want pack or unpack" >&2; exit 2 ;;
esac
