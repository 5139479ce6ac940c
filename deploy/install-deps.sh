#!/usr/bin/env bash
# Installs the Debian packages that CraftFleet is built with (Debian 12 or later).
# Does nothing if all are installed. Uses sudo when not run as root.
#
# Usage: deploy/install-deps.sh [--core] [--tests[=torch]] [--developer] [--libtorch=DIR|cuda]
#   --core          without the packages for windows, videos and plots, which are half of all on Debian 13
#   --tests         also the packages of the tests: GoogleTest, and those without which some tests are skipped, such as Slurm, a
#                   YAML parser, network namespaces, displays, terminals and a browser; and, from PyPI into .cache/python
#                   (300 MB), what the tests of the Python package need
#   --tests=torch   the same, and PyTorch with Stable-Baselines3 from PyPI (6 GB), for the tests of examples that train
#   --developer     also the packages for the other builds and checks of .ci/run: clang and its tools, ccache, lld, shellcheck
#   --libtorch=DIR  leave out Debian's LibTorch, because the build uses the one in DIR: an unpacked LibTorch, a Python
#                   environment with torch, or its site-packages; default: the environment variable CRAFTFLEET_LIBTORCH
#   --libtorch=cuda the LibTorch of torch 2.11.0 with CUDA 13, from PyPI, in a Python environment of its own in
#                   .cache/libtorch-cuda: 4.6 GB. If it is interrupted, the same command continues

set -euo pipefail

core=
tests=
developer=
libtorch=${CRAFTFLEET_LIBTORCH:-}
usage() { sed -n '2,/^$/s/^# \{0,1\}//p' "$0"; }
for argument in "$@"; do
  case "$argument" in
    --core) core=yes ;;
    --tests) tests=yes ;;
    --tests=torch) tests=torch ;;
    --developer) developer=yes ;;
    --libtorch=?*) libtorch=${argument#*=} ;;
    -h | --help) usage; exit 0 ;;
    *) echo "install-deps.sh: unknown argument '$argument'" >&2; usage >&2; exit 2 ;;
  esac
done

packages=(
  g++ cmake ninja-build git pkg-config
  protobuf-compiler protobuf-compiler-grpc libprotobuf-dev libgrpc++-dev libssl-dev
  libabsl-dev nlohmann-json3-dev zlib1g-dev libpng-dev libzip-dev prometheus-cpp-dev libmicrohttpd-dev
  libjs-chart.js  # charts of the live page and of reports, compiled in
  openssl  # deploy/make-certs.sh
  libgoogle-perftools-dev  # tcmalloc
  libtorch-dev
  libgloo-dev  # headers only: for several learners of one run
  libopenblas0-pthread  # with the reference BLAS, training is several times slower
  libopencv-core-dev libopencv-imgproc-dev  # not libopencv-dev, which needs every module
  libopencv-videoio-dev libopencv-highgui-dev
  python3 python3-matplotlib  # craftfleet report and curve
)
torch=2.11.0
torch_gb=4.6
torch_dir=$(readlink -f "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")/..")/.cache/libtorch-cuda

# pip installs torch after everything that it needs, and lists its files when all of them are there.
has_torch() { compgen -G "$torch_dir/lib/python3*/site-packages/torch-$torch*.dist-info/RECORD" >/dev/null; }
install_torch() {
  if has_torch; then
    echo "torch $torch is in $torch_dir."
  else
    mkdir -p "$torch_dir"
    local free_kib
    free_kib=$(df -Pk "$torch_dir" | awk 'NR == 2 {print $4}')
    if [ "$free_kib" -lt $((8 * 1024 * 1024)) ]; then
      echo "install-deps.sh: $torch_dir: $((free_kib / 1024)) MiB of disk are free, want 8192 for torch and its downloads" >&2
      exit 1
    fi
    echo "Installing torch $torch with CUDA 13 into $torch_dir: $torch_gb GB of disk, two minutes on a fast connection." \
         "Interrupted, the same command continues."
    python3 -m venv "$torch_dir"
    "$torch_dir/bin/pip" install "torch==$torch"
  fi
  echo "Build against it: deploy/build.sh release -DCRAFTFLEET_LIBTORCH=$torch_dir"
}

# What the tests of the Python package need, in an environment of its own. Without network they are skipped.
python_dir=${torch_dir%/*}/python
python_lists=${torch_dir%/.cache/*}/tests/deploy/python
# Argument: a list of packages in $python_lists.
install_python() {
  if cmp -s "$python_lists/$1" "$python_dir/$1"; then
    echo "The Python packages of the tests in $1 are in $python_dir."
    return
  fi
  echo "Installing the Python packages of the tests in $1 into $python_dir."
  if python3 -m venv "$python_dir" && "$python_dir/bin/pip" install --quiet --requirement "$python_lists/$1"; then
    cp "$python_lists/$1" "$python_dir/$1"
  else
    echo "install-deps.sh: pip failed, see above: the tests of the Python package will be skipped" >&2
  fi
}
finish() {
  if [ -n "$tests" ]; then install_python requirements.txt; fi
  if [ "$tests" = torch ]; then install_python requirements-torch.txt; fi
  if [ "$libtorch" = cuda ]; then install_torch; fi
  exit 0
}

if [ "$libtorch" = cuda ]; then
  packages+=(python3-venv python3-dev)  # deploy/wheel.sh compiles the game for Python
elif [ -n "$libtorch" ]; then
  found=
  for dir in "$libtorch"{,/libtorch,/torch,/lib{,64}/python3*/{site,dist}-packages/torch}; do
    [ ! -e "$dir/lib/libtorch_cpu.so" ] || found=yes
  done
  if [ -z "$found" ]; then
    echo "install-deps.sh: --libtorch=$libtorch: no LibTorch there; want an unpacked LibTorch, a Python environment with" \
         "torch, or its site-packages" >&2
    exit 2
  fi
fi
# Argument: a package that is not wanted.
leave_out() {
  local i
  for i in "${!packages[@]}"; do
    [ "${packages[$i]}" != "$1" ] || unset "packages[$i]"
  done
}
if [ -n "$libtorch" ]; then leave_out libtorch-dev; fi
if [ -n "$core" ] && [ -z "$tests" ]; then
  for package in libopencv-videoio-dev libopencv-highgui-dev python3-matplotlib; do leave_out "$package"; done
fi
if [ -n "$tests" ]; then
  packages+=(libgtest-dev libgmock-dev libbenchmark-dev libopencv-imgcodecs-dev)
  packages+=(less xz-utils python3-pandas python3-venv python3-dev python3-yaml iproute2 prometheus munge slurmctld slurmd slurm-client tmux xvfb xdotool
    chromium chromium-driver python3-selenium qemu-user)
fi
if [ -n "$developer" ]; then
  packages+=(ccache lld clang libclang-rt-dev llvm clang-format clang-tidy shellcheck xz-utils)
fi

if ! command -v apt-get >/dev/null || ! command -v dpkg-query >/dev/null; then
  echo "install-deps.sh: this system has no apt. Install the equivalents of these Debian packages:" >&2
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
  finish
fi

as_root=(env DEBIAN_FRONTEND=noninteractive)
if [ "$(id -u)" -ne 0 ]; then
  if ! command -v sudo >/dev/null; then
    echo "install-deps.sh: needs root or sudo. Ask an administrator to install: ${missing[*]}" >&2
    exit 1
  fi
  as_root=(sudo "${as_root[@]}")
fi

echo "Installing: ${missing[*]}"
"${as_root[@]}" apt-get update -qq
"${as_root[@]}" apt-get install -y -qq --no-install-recommends "${missing[@]}"
finish
