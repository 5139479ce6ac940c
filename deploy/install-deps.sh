#!/usr/bin/env bash
# Installs what CraftFleet is built and tested with, from Debian's own packages (Debian 12 or later).
# Does nothing when all of it is there; uses sudo when not run as root.
#
# Usage: deploy/install-deps.sh [--tests] [--developer] [--libtorch=DIR]
#   --tests      also what some tests look at deployments with, and are skipped without: Slurm, a YAML parser,
#                network namespaces
#   --developer  also what the other builds and checks of .ci/run need: clang with its tools, shellcheck
#   --libtorch=DIR  without Debian's LibTorch: the build takes the one in DIR, an unpacked LibTorch, a Python environment
#                   with torch, or its site-packages; default: the environment variable CRAFTFLEET_LIBTORCH, if it is set

set -euo pipefail

tests=
developer=
libtorch=${CRAFTFLEET_LIBTORCH:-}
usage() { sed -n '2,/^$/s/^# \{0,1\}//p' "$0"; }
for argument in "$@"; do
  case "$argument" in
    --tests) tests=yes ;;
    --developer) developer=yes ;;
    --libtorch=?*) libtorch=${argument#*=} ;;
    -h | --help) usage; exit 0 ;;
    *) echo "install-deps.sh: unknown argument '$argument'" >&2; usage >&2; exit 2 ;;
  esac
done

packages=(
  g++ cmake ninja-build git pkg-config
  protobuf-compiler protobuf-compiler-grpc libprotobuf-dev libgrpc++-dev libssl-dev
  libabsl-dev nlohmann-json3-dev zlib1g-dev libzip-dev prometheus-cpp-dev
  openssl  # deploy/make-certs.sh
  libgoogle-perftools-dev  # tcmalloc
  libtorch-dev
  libopenblas0-pthread  # with the reference BLAS, training is several times slower
  libopencv-dev
  libgtest-dev libgmock-dev libbenchmark-dev python3
)
if [ -n "$libtorch" ]; then
  found=
  for dir in "$libtorch"{,/libtorch,/torch,/lib{,64}/python3*/{site,dist}-packages/torch}; do
    [ ! -e "$dir/lib/libtorch_cpu.so" ] || found=yes
  done
  if [ -z "$found" ]; then
    echo "install-deps.sh: --libtorch=$libtorch: no LibTorch there; want an unpacked LibTorch, a Python environment with" \
         "torch, or its site-packages" >&2
    exit 2
  fi
  for i in "${!packages[@]}"; do
    [ "${packages[$i]}" != libtorch-dev ] || unset "packages[$i]"
  done
fi
if [ -n "$tests" ]; then
  packages+=(python3-yaml iproute2 prometheus munge slurmctld slurmd slurm-client)
fi
if [ -n "$developer" ]; then
  packages+=(clang libclang-rt-14-dev llvm clang-format clang-tidy shellcheck)
fi

if ! command -v apt-get >/dev/null || ! command -v dpkg-query >/dev/null; then
  echo "install-deps.sh: no apt here. Install by your system's own means what Debian calls:" >&2
  echo "  ${packages[*]}" >&2
  exit 1
fi

missing=()
for package in "${packages[@]}"; do
  status=$(dpkg-query --show --showformat='${Status}' "$package" 2>/dev/null || true)
  [ "$status" = "install ok installed" ] || missing+=("$package")
done
if [ ${#missing[@]} -eq 0 ]; then
  echo "All ${#packages[@]} packages are installed."
  exit 0
fi

as_root=(env DEBIAN_FRONTEND=noninteractive)
if [ "$(id -u)" -ne 0 ]; then
  if ! command -v sudo >/dev/null; then
    echo "install-deps.sh: neither root nor sudo here. Have an administrator install: ${missing[*]}" >&2
    exit 1
  fi
  as_root=(sudo "${as_root[@]}")
fi

echo "Installing: ${missing[*]}"
"${as_root[@]}" apt-get update -qq
"${as_root[@]}" apt-get install -y -qq --no-install-recommends "${missing[@]}"
