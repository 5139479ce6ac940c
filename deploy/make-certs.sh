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
refuse() { echo "make-certs.sh: $*" >&2; exit 2; }
[[ $days =~ ^[1-9][0-9]{0,4}$ ]] || refuse "--days=$days, want 1..99999"
dir=$1
shift
for argument in "$@"; do
  name=${argument%%=*}
  [[ $name =~ ^[A-Za-z0-9_.*][A-Za-z0-9_.*-]*$ && $name != ca ]] ||
    refuse "'$argument', want NAME[=HOST,...] of letters, digits and ._*-, other than ca; options come before DIR"
done

[ -e "$dir/ca.pem" ] || [ ! -e "$dir/ca.key" ] ||
  refuse "$dir/ca.key is there without ca.pem: put ca.pem back, or remove ca.key for a new authority"

umask 077
mkdir -p "$dir"
work=$(mktemp -d "$dir/.new.XXXXXX")
trap 'rm -rf "$work"' EXIT
new_key=(-newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes)
printf '%s\n' '[ca]' 'default_ca=this' '[this]' 'database=index' 'rand_serial=yes' 'default_md=sha256' 'policy=any' \
  'unique_subject=no' '[any]' 'commonName=supplied' >"$work/config"
: >"$work/index"

# Arguments: the request and the certificate to make of it, in $work; its days; its extensions, in one word; options of
# openssl ca. It begins a day ago, because clocks differ.
sign() {
  local request=$1 certificate=$2 days=$3 extensions=$4
  shift 4
  (cd "$work" && openssl ca -batch -notext -config config -outdir . -in "$request" -out "$certificate" \
    -startdate "$(date -u -d '-1 day' +%Y%m%d%H%M%SZ)" -enddate "$(date -u -d "+$days days" +%Y%m%d%H%M%SZ)" \
    -extfile <(echo "$extensions") "$@") 2>"$work/log" || { cat "$work/log" >&2; exit 1; }
}
# Arguments: key, request and name.
request() {
  openssl req -new "${new_key[@]}" -keyout "$1" -out "$2" -subj "/CN=$3" 2>"$work/log" || { cat "$work/log" >&2; exit 1; }
}

if [ ! -e "$dir/ca.pem" ]; then
  request "$work/ca.key" "$work/request" "CraftFleet CA"
  sign request ca.pem 3650 "$(printf '%s\n' "basicConstraints=critical,CA:TRUE" \
    "keyUsage=critical,keyCertSign,cRLSign" "subjectKeyIdentifier=hash")" -selfsign -keyfile ca.key
  mv "$work/ca.key" "$work/ca.pem" "$dir/"
fi

for argument in "$@"; do
  name=${argument%%=*}
  names="DNS:$name,DNS:localhost,IP:127.0.0.1,IP:::1"
  if [[ "$argument" == *=* ]]; then
    IFS=, read -r -a hosts <<<"${argument#*=}"
    for host in "${hosts[@]}"; do
      if [[ "$host" =~ ^[0-9.]+$ || "$host" == *:* ]]; then names+=",IP:$host"; else names+=",DNS:$host"; fi
    done
  fi
  request "$work/key" "$work/request" "$name"
  sign request pem "$days" "$(printf '%s\n' "subjectAltName=$names" "basicConstraints=CA:FALSE" \
    "extendedKeyUsage=serverAuth,clientAuth")" -cert ../ca.pem -keyfile ../ca.key
  mv "$work/key" "$dir/$name.key"
  mv "$work/pem" "$dir/$name.pem"
  echo "$dir/$name.pem, $dir/$name.key: $names, $days days"
done
