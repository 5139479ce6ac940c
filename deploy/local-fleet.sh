#!/usr/bin/env bash
# Runs a fleet on this machine: a learner, actors and environment servers as separate processes, connected by Unix
# sockets in a folder that only this user can enter. All of them stop when the run is complete, at Ctrl-C or SIGTERM (the
# learner saves its last iteration; the same command with --resume continues the run), and when this script is killed.
#
# Usage: deploy/local-fleet.sh [--learners=L] [--actors=N] [--envservers=M] [--bin=DIR] --logdir=DIR [LEARNER FLAG]...
#   --learners=L     default 1; more share the updates out, at most gradient_shards of the run
#   --actors=N       default 1
#   --envservers=M   default 1
#   --bin=DIR        folder of the programs; default: those of this checkout, installation or wheel, or else the folder in PATH
#   --logdir=DIR     folder of the run; the workers' logs are appended to DIR/fleet/NAME.log
#   LEARNER FLAG     any flag of craftfleet-learner (see its --help); --textures goes to the environment servers too,
#                    --tls_cert, --tls_key, --tls_ca and --tls_server_name to all workers
# The exit code is the learner's, or 1 if no actor or no environment server is left. Where these left with 0, as at the end of a
# run, the learner has 300 s to write its last checkpoint.

set -euo pipefail

usage() { sed -n '2,/^$/s/^# \{0,1\}//p' "$0"; }
refuse() { echo "local-fleet.sh: $*" >&2; exit 2; }
say() { echo "local-fleet.sh: $*" >&2; }

here=$(dirname "$(readlink -f "$0")")
bin=$here/../build/bin
[ -x "$bin/craftfleet-learner" ] || bin=$here/../../bin  # installed, also as a wheel
[ -x "$bin/craftfleet-learner" ] || bin=$(dirname "$(command -v craftfleet-learner || echo "$bin/craftfleet-learner")")
learners=1
actors=1
envservers=1
logdir=
learner_flags=()
envserver_flags=()
channel_flags=()
for argument in "$@"; do
  case "$argument" in
    --*=\~ | --*=\~/*) argument=${argument%%=*}=$HOME${argument#*=\~} ;;  # the shell expands ~ at the start of a word only
  esac
  case "$argument" in
    -h | --help) usage; exit 0 ;;
    --learners=*) learners=${argument#*=} ;;
    --actors=*) actors=${argument#*=} ;;
    --envservers=*) envservers=${argument#*=} ;;
    --bin=*) bin=${argument#*=} ;;
    --listen=*) refuse "$argument: the fleet uses its own Unix sockets" ;;
    --rank=* | --world_size=*) refuse "$argument: give --learners=L" ;;
    --*)
      learner_flags+=("$argument")
      case "$argument" in
        --logdir=*) logdir=${argument#*=} ;;
        --textures=*) envserver_flags+=("$argument") ;;
        --tls_cert=* | --tls_key=* | --tls_ca=* | --tls_server_name=*) channel_flags+=("$argument") ;;
      esac
      ;;
    *) refuse "'$argument' is not a flag of the form --NAME=VALUE; see --help" ;;
  esac
done
[[ $learners =~ ^[1-9][0-9]{0,2}$ ]] || refuse "--learners=$learners, want 1..999"
[[ $actors =~ ^[1-9][0-9]{0,2}$ ]] || refuse "--actors=$actors, want 1..999"
[[ $envservers =~ ^[1-9][0-9]{0,2}$ ]] || refuse "--envservers=$envservers, want 1..999"
[ -n "$logdir" ] || refuse "--logdir is missing: the folder to write the run to"
for program in learner actor envserver; do
  [ -x "$bin/craftfleet-$program" ] || refuse "$bin/craftfleet-$program does not exist: build first (deploy/build.sh), or give --bin=DIR"
done

# Argument: the folder of the sockets. The length in bytes of the longest path in it.
socket_length() {
  local LC_ALL=C path="$1/envserver-$envservers"
  echo ${#path}
}
folder=${TMPDIR:-/tmp}
[[ $folder != *,* ]] || refuse "TMPDIR=$folder: paths of Unix sockets may not have commas: set TMPDIR to another folder"
length=$(socket_length "$folder/craftfleet.XXXXXX")
[ "$length" -le 107 ] || refuse "TMPDIR=$folder: paths of Unix sockets there have $length bytes, want at most 107: set TMPDIR to a shorter folder"
if [ ! -d "$folder" ] || [ ! -w "$folder" ]; then
  refuse "TMPDIR=$folder is not a folder that can be written: set TMPDIR to one for Unix sockets"
fi
# nproc counts the threads that OpenMP may use.
cores=$(env -u OMP_NUM_THREADS -u OMP_THREAD_LIMIT nproc)
mkdir -p "$logdir/fleet"
sockets=$(mktemp -d "$folder/craftfleet.XXXXXX")
declare -A names=()  # the running workers, by process id
patience=${CRAFTFLEET_FLEET_PATIENCE:-300}  # seconds; tests have less

# Each process has a group of its own, so that Ctrl-C reaches it once, through this script.
set -m

# Arguments: name, program, flags. The kernel sends SIGTERM to the process when this script is gone.
start_worker() {
  local name=$1
  shift
  setpriv --pdeathsig TERM "$@" </dev/null >>"$logdir/fleet/$name.log" 2>&1 &
  names[$!]=$name
}

# Arguments: process ids. Sends SIGTERM, and after 15 s SIGKILL to those that still run.
stop() {
  local deadline=$((SECONDS + 15)) pid
  kill -TERM "$@" 2>/dev/null || true
  for pid in "$@"; do
    while kill -0 "$pid" 2>/dev/null && [ "$SECONDS" -lt "$deadline" ]; do sleep 0.05; done
    kill -KILL "$pid" 2>/dev/null || true
  done
}

clean_up() {
  trap '' INT TERM HUP
  exec 2>/dev/null  # bash names the jobs that a signal ended
  stop "${learner:-}" "${!names[@]}"
  rm -rf "$sockets"
}
trap clean_up EXIT

stopping=
# shellcheck disable=SC2317  # called by the trap
on_signal() {
  [ -z "$stopping" ] && say "stopping"
  stopping=yes
  kill -TERM "$learner" 2>/dev/null || true
}

# A port of loopback that nobody listens on.
free_port() {
  local port
  while port=$((20000 + RANDOM % 10000)); (exec 3<>"/dev/tcp/127.0.0.1/$port") 2>/dev/null; do :; done
  echo "$port"
}

learner_flags=(--world_size="$learners" "${learner_flags[@]}")
if [ "$learners" -gt 1 ]; then
  threads=$((cores / learners))
  learner_flags=(--threads="$((threads > 0 ? threads : 1))" --master_addr=127.0.0.1 --master_port="$(free_port)" "${learner_flags[@]}")
fi
setpriv --pdeathsig TERM "$bin/craftfleet-learner" "${learner_flags[@]}" --rank=0 --listen="unix:$sockets/learner" </dev/null &
learner=$!
trap on_signal INT TERM HUP
for ((i = 1; i < learners; i++)); do
  start_worker "learner-$i" "$bin/craftfleet-learner" "${learner_flags[@]}" --rank="$i" --metrics_listen=
done

servers=
for ((i = 1; i <= envservers; i++)); do
  start_worker "envserver-$i" "$bin/craftfleet-envserver" --listen="unix:$sockets/envserver-$i" "${envserver_flags[@]}" "${channel_flags[@]}"
  servers+=,unix:$sockets/envserver-$i
done
threads=$((cores / actors))
for ((i = 1; i <= actors; i++)); do
  start_worker "actor-$i" "$bin/craftfleet-actor" --listen="unix:$sockets/actor-$i" --learner="unix:$sockets/learner" \
    --envservers="${servers#,}" --threads="$((threads > 0 ? threads : 1))" "${channel_flags[@]}"
done
say "learners: $learners, actors: $actors, environment servers: $envservers; watch: craftfleet status$(printf ' %q' --address="unix:$sockets/learner" "${channel_flags[@]}")"

# Argument: a kind of worker, such as actor. True while one of them runs.
any_left() {
  local name
  for name in "${names[@]}"; do
    [[ $name != "$1"-* ]] || return 0
  done
  return 1
}

while true; do
  ended=
  status=0
  # When a command ends, bash forgets the jobs that a signal has ended meanwhile: wait -n does not find them, wait does.
  for pid in "${!names[@]}" "$learner"; do kill -0 "$pid" 2>/dev/null || ended=$pid; done
  if [ -n "$ended" ]; then
    wait "$ended" || status=$?
  else
    wait -n -p ended "$learner" "${!names[@]}" || status=$?
  fi
  [ -n "${ended:-}" ] || continue  # a signal
  if [ "$ended" = "$learner" ]; then
    learner=
    # 143: the learner got the signal before it had set up its handlers, so there is no run to save.
    if [ -n "$stopping" ] && [ "$status" -eq 143 ]; then status=0; fi
    exit "$status"
  fi
  name=${names[$ended]}
  unset "names[$ended]"
  [ "$status" -eq 0 ] || say "$name ended with exit code $status: $(tail -n 1 "$logdir/fleet/$name.log")"
  if any_left actor && any_left envserver; then continue; fi
  case $name:$status in
    patience-:*) [ -z "$stopping" ] || continue ;;
    *:0)  # at the end of the run actors exit on their own, before the learner has written its last checkpoint
      if ! any_left patience; then
        say "workers have left; the learner has $patience s to write its last checkpoint"
        setpriv --pdeathsig TERM sleep "$patience" &
        names[$!]=patience-
      fi
      continue
      ;;
  esac
  say "no actor or no environment server is left: see $logdir/fleet"
  exit 1
done
