#!/usr/bin/env bash
# Prints the name or address under which other hosts reach this one: its name, or an address of the network where the name
# is one of loopback here, as Debian's installer sets it in /etc/hosts (127.0.1.1).

set -uo pipefail

host=$(hostname)
addresses=$(getent ahosts "$host" | awk '$1 !~ /^(127\.|::1$)/')
[ -n "$addresses" ] || host=$(hostname -I | tr ' ' '\n' | awk '/\./ {print; exit}')
echo "${host:-$(hostname)}"
