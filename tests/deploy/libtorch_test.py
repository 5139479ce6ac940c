"""cmake/libtorch.cmake and deploy/install-deps.sh: which LibTorch a build uses."""

import os
import shutil
import subprocess

from tests.fakes import python_case
from tests.fakes.python_case import SOURCE

# A symbol that distinguishes the two C++ ABIs.
NEW_ABI = b"\0_ZN3c105ErrorC2ENS_14SourceLocationENSt7__cxx1112basic_stringIcSt11char_traitsIcESaIcEEE\0"
OLD_ABI = b"\0_ZN3c105ErrorC2ENS_14SourceLocationESs\0"
PROJECT = """
cmake_minimum_required(VERSION 3.25)
project(test LANGUAGES NONE)
include({source}/cmake/libtorch.cmake)
get_target_property(libraries craftfleet_torch INTERFACE_LINK_LIBRARIES)
message(STATUS "links ${{libraries}}")
"""


class FoundLibtorch(python_case.FolderCase):

  def setUp(self):
    super().setUp()
    (self.folder / "CMakeLists.txt").write_text(PROJECT.format(source=SOURCE))

  def libtorch(self, folder, version=(2, 11), abi=NEW_ABI, cuda=False):
    root = self.folder / folder
    header = root / "include/torch/csrc/api/include/torch/version.h"
    header.parent.mkdir(parents=True)
    header.write_text("#pragma once\n#include <torch/headeronly/version.h>\n")
    newer = root / "include/torch/headeronly/version.h"
    newer.parent.mkdir()
    newer.write_text(f"#define TORCH_VERSION_MAJOR {version[0]}\n\n/// Minor\n#define TORCH_VERSION_MINOR {version[1]}\n")
    for name in ("ATen", "c10", "caffe2", "google"):
      (root / "include" / name).mkdir()
    (root / "lib").mkdir()
    (root / "lib/libc10.so").write_bytes(abi)
    for name in ["libtorch.so", "libtorch_cpu.so"] + ["libtorch_cuda.so"] * cuda:
      (root / "lib" / name).touch()
    return root

  def configure(self, folder, variable=False):
    build = self.folder / "build"
    shutil.rmtree(build, ignore_errors=True)
    environment = {name: value for name, value in os.environ.items() if name != "CRAFTFLEET_LIBTORCH"}
    if variable:
      environment["CRAFTFLEET_LIBTORCH"] = str(folder)
    flags = [] if variable else [f"-DCRAFTFLEET_LIBTORCH={folder}"]
    return subprocess.run(["cmake", "-G", "Ninja", "-S", self.folder, "-B", build, *flags], capture_output=True, text=True, check=False, env=environment)

  def assert_refused(self, reason, ended):
    self.assertNotEqual(ended.returncode, 0)
    self.assertIn(reason, " ".join(ended.stderr.split()))

  def test_folders_around_it_lead_to_it(self):
    site = "venv/lib/python3.12/site-packages"
    in_python, archive = self.libtorch(f"{site}/torch", cuda=True), self.libtorch("unpacked/libtorch", version=(2, 6))
    for folder in (self.folder / "venv", self.folder / site, in_python):
      ended = self.configure(folder)
      self.assertIn(f"LibTorch 2.11 (CUDA ON): {in_python}/lib", ended.stdout, ended.stderr)
      self.assertIn(f"{in_python}/lib/libtorch_cpu.so", ended.stdout)
    self.assertIn(f"LibTorch 2.11 (CUDA ON): {in_python}/lib", self.configure(self.folder / "venv", variable=True).stdout)
    for folder in (archive, archive.parent):
      self.assertIn(f"LibTorch 2.6 (CUDA OFF): {archive}/lib", self.configure(folder).stdout)

  def test_only_its_own_headers_are_used(self):
    self.libtorch("named")
    self.assertEqual(self.configure(self.folder / "named").returncode, 0)
    self.assertEqual({path.name for path in (self.folder / "build/libtorch/include").iterdir()}, {"ATen", "c10", "caffe2", "torch"})

  def test_an_unusable_libtorch_is_refused(self):
    (self.folder / "empty").mkdir()
    self.assert_refused("empty: no LibTorch there; want an unpacked LibTorch", self.configure(self.folder / "empty"))
    self.libtorch("old-abi", abi=OLD_ABI)
    self.assert_refused("this LibTorch has the pre-C++11 ABI", self.configure(self.folder / "old-abi"))
    self.libtorch("old", version=(1, 12))
    self.assert_refused("want 1.13 or newer", self.configure(self.folder / "old"))


class InstallDeps(python_case.FolderCase):

  def install(self, *flags):
    """Runs the script on a system without packages on which nothing can be installed."""
    tools = self.folder / "tools"
    if not tools.exists():
      tools.mkdir()
      for tool in ("bash", "dirname", "env", "readlink", "sed"):
        (tools / tool).symlink_to(shutil.which(tool))
      for tool, line in (("apt-get", "exit 1"), ("dpkg-query", "exit 1"), ("id", "echo 1000")):
        (tools / tool).write_text(f"#!{shutil.which('sh')}\n{line}\n")
        (tools / tool).chmod(0o755)
    return subprocess.run([SOURCE / "deploy/install-deps.sh", *flags], capture_output=True, text=True, check=False, env={"PATH": str(tools)})

  def test_an_existing_libtorch_is_not_installed_again(self):
    packages = self.install().stderr
    self.assertIn(" libtorch-dev ", packages)
    library = self.folder / "venv/lib/python3.12/site-packages/torch/lib/libtorch_cpu.so"
    library.parent.mkdir(parents=True)
    library.touch()
    for folder in (self.folder / "venv", library.parent.parent, library.parent.parent.parent):
      self.assertEqual(self.install(f"--libtorch={folder}").stderr, packages.replace(" libtorch-dev ", " "))

  def test_windows_videos_and_plots_can_be_left_out(self):
    extras = {"libopencv-highgui-dev", "libopencv-videoio-dev", "python3-matplotlib"}
    packages = set(self.install().stderr.split())
    self.assertLess(extras, packages)
    self.assertEqual(set(self.install("--core").stderr.split()), packages - extras)

  def test_only_the_tests_need_googletest_and_image_codecs(self):
    wanted = {"libgtest-dev", "libgmock-dev", "libbenchmark-dev", "libopencv-imgcodecs-dev"}
    self.assertFalse(wanted & set(self.install().stderr.split()))
    self.assertLess(wanted, set(self.install("--tests").stderr.split()))

  def with_cuda(self, pip="exit 0", free_kib=9 * 2**20):
    """`--libtorch=cuda` in a checkout where all packages are installed, with a fake pip: the ended script, and pip's calls."""
    checkout = self.folder / "checkout"
    tools = self.folder / "cuda-tools"
    for folder in (checkout / "deploy", tools):
      folder.mkdir(parents=True, exist_ok=True)
    shutil.copy(SOURCE / "deploy/install-deps.sh", checkout / "deploy")
    calls = self.folder / "calls"
    calls.write_text("")
    # python3 -m venv DIR
    fake_pip = f"#!/bin/sh\necho $* >>{calls}\nsite=$(dirname $0)/../lib/python3.12/site-packages\n{pip}\n"
    (self.folder / "pip").write_text(fake_pip)
    for tool, line in (("apt-get", "exit 1"), ("dpkg-query", "echo install ok installed"), ("df", f"echo head; echo d 1 1 {free_kib}"),
                       ("python3", f'mkdir -p "$3/bin"; cp {self.folder}/pip "$3/bin/pip"; chmod +x "$3/bin/pip"')):
      (tools / tool).write_text(f"#!/bin/sh\n{line}\n")
      (tools / tool).chmod(0o755)
    ended = subprocess.run([checkout / "deploy/install-deps.sh", "--libtorch=cuda"], capture_output=True, text=True, check=False,
                           env={"PATH": f"{tools}:/usr/bin:/bin"})
    return ended, calls.read_text().splitlines()

  def test_cuda_is_installed_from_the_wheel_and_an_interrupted_installation_continues(self):
    place = self.folder / "checkout/.cache/libtorch-cuda"
    install = "mkdir -p $site/torch-2.11.0.dist-info; touch $site/torch-2.11.0.dist-info/RECORD"
    for _ in range(2):
      ended, calls = self.with_cuda(pip="exit 7")
      self.assertEqual((ended.returncode, calls), (7, ["install torch==2.11.0"]))
      self.assertIn(f"Installing torch 2.11.0 with CUDA 13 into {place}: 4.6 GB of disk", ended.stdout)
      self.assertNotIn("Build against it", ended.stdout)
    advice = f"Build against it: deploy/build.sh release -DCRAFTFLEET_LIBTORCH={place}"
    ended, calls = self.with_cuda(pip=install)
    self.assertEqual((ended.returncode, calls), (0, ["install torch==2.11.0"]), ended.stderr)
    self.assertEqual(ended.stdout.splitlines()[-1], advice)
    ended, calls = self.with_cuda(pip="exit 7")
    self.assertEqual((ended.returncode, calls), (0, []), "it is there already")
    self.assertEqual(ended.stdout.splitlines()[-2:], [f"torch 2.11.0 is in {place}.", advice])

  def test_cuda_takes_the_packages_for_it_and_not_debians_libtorch(self):
    packages = self.install().stderr.replace(" libtorch-dev ", " ").replace("\n", " python3-venv python3-dev\n")
    self.assertEqual(self.install("--libtorch=cuda").stderr, packages)

  def test_cuda_on_a_full_disk_is_said_before_the_download(self):
    ended, calls = self.with_cuda(free_kib=100 * 1024)
    self.assertEqual((ended.returncode, calls), (1, []))
    self.assertIn("libtorch-cuda: 100 MiB of disk are free, want 8192", ended.stderr)

  def test_a_folder_without_libtorch_is_refused(self):
    ended = self.install(f"--libtorch={self.folder}")
    self.assertEqual(ended.returncode, 2)
    self.assertIn(f"--libtorch={self.folder}: no LibTorch there", ended.stderr)


python_case.main()
