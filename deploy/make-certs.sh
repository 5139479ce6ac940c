#!/usr/bin/env bash
# Makes the certificates of a fleet with openssl: an authority, and a certificate and key from it for each name.
#
# Usage: deploy/make-certs.sh [--days=N] DIR NAME[=HOST,HOST,...]...
#   DIR      folder for ca.pem and ca.key, which are kept if they exist, and for NAME.pem and NAME.key of each NAME,
#            which are replaced if they exist
#   NAME     the name of the holder in the --access_file (the common name)
#   HOST     host names and IP addresses of the holder, in addition to NAME, localhost, 127.0.0.1 and ::1
#   --days   validity of the certificates (default 90); the authority is valid for ten years
#
# Keep ca.key away from the fleet: anyone who has it can make certificates.
#
#   deploy/make-certs.sh certs learner=learner.example.com,10.0.0.5 envserver actor ops

set -euo pipefail

usage() { sed -n '2,/^$/s/^# \{0,1\}//p' "$0"; }

days=90
while [[ "${1:-}" == -* ]]; do
  case "$1" in
    --days=*) days=${1#--days=} ;;
    -h | --help) usage; exit 0 ;;
    *) echo "make-certs.sh: unknown argument '$1'" >&2; usage >&2; exit 2 ;;
  esac
  shift
done
if [ $# -lt 2 ]; then
  usage >&2
  exit 2
fi
dir=$1
shift

umask 077
mkdir -p "$dir"
new_key=(-newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes)

if [ ! -e "$dir/ca.pem" ]; then
  openssl req -x509 "${new_key[@]}" -keyout "$dir/ca.key" -out "$dir/ca.pem" -days 3650 -subj "/CN=CraftFleet CA" \
    -addext "basicConstraints=critical,CA:TRUE" -addext "keyUsage=critical,keyCertSign,cRLSign" 2>/dev/null
fi

work=$(mktemp -d "$dir/.new.XXXXXX")
trap 'rm -rf "$work"' EXIT

for argument in "$@"; do
  name=${argument%%=*}
  names="DNS:$name,DNS:localhost,IP:127.0.0.1,IP:::1"
  if [[ "$argument" == *=* ]]; then
    IFS=, read -r -a hosts <<<"${argument#*=}"
    for host in "${hosts[@]}"; do
      if [[ "$host" =~ ^[0-9.]+$ || "$host" == *:* ]]; then names+=",IP:$host"; else names+=",DNS:$host"; fi
    done
  fi
  openssl req -new "${new_key[@]}" -keyout "$work/key" -out "$work/request" -subj "/CN=$name" 2>/dev/null
  openssl x509 -req -in "$work/request" -CA "$dir/ca.pem" -CAkey "$dir/ca.key" -set_serial "0x$(openssl rand -hex 8)" \
    -days "$days" -out "$work/pem" 2>/dev/null \
    -extfile <(printf '%s\n' "subjectAltName=$names" "basicConstraints=CA:FALSE" "extendedKeyUsage=serverAuth,clientAuth")
  mv "$work/key" "$dir/$name.key"
  mv "$work/pem" "$dir/$name.pem"
  echo "$dir/$name.pem, $dir/$name.key: $names, $days days"
done
