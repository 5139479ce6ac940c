#!/usr/bin/env bash
# Makes certificates for a fleet in Kubernetes and prints them as Secrets: an authority (kept in DIR; store its ca.key in a
# safe place), and one certificate each for the learner, actors, environment servers and operators
# (DIR/craftfleet-ops.pem and .key). Run it again with the same DIR to renew the certificates; a running fleet picks them up.
#
# Usage: deploy/k8s/tls-secrets.sh DIR | kubectl apply -f -

set -euo pipefail

usage() { sed -n '2,/^$/s/^# \{0,1\}//p' "$0"; }
case "${1:-}" in
  -h | --help) usage; exit 0 ;;
  "" | -*) usage >&2; exit 2 ;;
esac
dir=$1
names=(craftfleet-learner craftfleet-envserver craftfleet-actor craftfleet-ops)
"$(dirname "$(readlink -f "$0")")/../make-certs.sh" "$dir" "${names[@]}" >&2
for name in "${names[@]}"; do
  cat <<SECRET
---
apiVersion: v1
kind: Secret
metadata:
  name: $name-tls
  namespace: craftfleet
type: kubernetes.io/tls
data:
  tls.crt: $(base64 --wrap=0 <"$dir/$name.pem")
  tls.key: $(base64 --wrap=0 <"$dir/$name.key")
  ca.crt: $(base64 --wrap=0 <"$dir/ca.pem")
SECRET
done
