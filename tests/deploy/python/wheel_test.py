"""deploy/wheel.sh: a wheel of this build brings the programs and their libraries, and they find LibTorch in Python's torch.

Builds with windows and videos, which need more than a hundred libraries, and those under AddressSanitizer are not packed. The test
then puts the programs, the scripts and share/ where pip would, beside the package that install_test.py has installed.
"""

import os
import pathlib
import re
import shutil
import subprocess
import sys
import unittest
import zipfile

from tests.deploy.python import package
from tests.fakes import python_case
from tests.fakes.python_case import BIN, SMALL_RUN, SOURCE, cmake_setting

package.need("craftfleet", "scikit_build_core", "nanobind", "numpy", "gymnasium", "auditwheel")
import numpy  # pylint: disable=wrong-import-position

MADE = BIN.parent / "wheel"
ENVIRONMENT = MADE / "venv"
MAX_WHEEL_BYTES = 25 << 20
OF_LIBTORCH = re.compile(r"/lib(torch|c10|caffe2)")
# What every system with Python has.
OF_THE_SYSTEM = re.compile(r"/(ld-linux.*|lib(c|m|mvec|dl|pthread|rt|util|resolv|anl|gcc_s|stdc\+\+|z))\.so\.\d+$")
IS_SMALL = cmake_setting("CRAFTFLEET_WITH_VIDEO") == cmake_setting("CRAFTFLEET_WITH_WINDOW") == "OFF"
IS_PACKED = IS_SMALL and b"__asan_init" not in (BIN / "craftfleet").read_bytes()
needs_packing = unittest.skipUnless(IS_PACKED, "want a build without windows, videos and AddressSanitizer, as of the preset wheel")
PROGRAMS = {path.name for path in BIN.glob("craftfleet*") if "_" not in path.name}
# In place of the Python that makes the wheel: keeps what deploy/wheel.sh has gathered for it.
KEEPING_PYTHON = """#!/bin/sh
for word; do
  case $word in *=cmake.define.CRAFTFLEET_PROGRAMS=*) cp -r "${word##*=}" "$(dirname "$0")/gathered" ;; esac
done
exit 3
"""


def packages():
  """The site-packages of the environment with the wheel."""
  (site,) = ENVIRONMENT.glob("lib/python3*/site-packages")
  return site


def libraries(program, **environment):
  """Paths of the libraries that the loader finds for the program; None where it finds none."""
  text = subprocess.run(["ldd", program], capture_output=True, text=True, check=True, env={"PATH": "/usr/bin:/bin", **environment}).stdout
  found = re.findall(r"^\s*(\S+) => (not found|/.*?)(?: \(0x\w+\))?$", text, re.MULTILINE)
  return {name: None if path == "not found" else path for name, path in found}


class Wheel(python_case.FolderCase):

  def run_in_environment(self, *words, code=0, **variables):
    ended = subprocess.run(
        [ENVIRONMENT / "bin" / words[0], *words[1:]], capture_output=True, text=True, timeout=300, check=False, cwd=self.folder,
        env={"PATH": "/usr/bin:/bin", "OMP_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": "1", **variables})
    self.assertEqual(ended.returncode, code, ended.stderr)
    return ended.stderr if code else ended.stdout

  def with_torch(self, version=None):
    """A folder of Python packages with this build's LibTorch, laid out as in torch's wheel, or with one of another version."""
    lib = pathlib.Path(cmake_setting("CRAFTFLEET_LIBTORCH_LIB_DIR"))
    if version is None and lib.match("site-packages/torch/lib"):
      return str(lib.parents[1])
    torch = self.folder / "packages/torch"
    (torch / "lib").mkdir(parents=True)
    (torch / "__init__.py").write_text("raise ImportError('not to be imported')\n")
    version = version or cmake_setting("CRAFTFLEET_LIBTORCH_VERSION")
    (torch / "version.py").write_text(f"from typing import Optional\n__version__ = '{version}.0+cpu'\n")
    for path in lib.glob("lib*.so*"):
      if OF_LIBTORCH.search(str(path)):
        (torch / "lib" / path.name).symlink_to(path)
    return str(torch.parent)

  @staticmethod
  def make(python):
    """Runs deploy/wheel.sh for this build, with an empty folder for the wheel."""
    shutil.rmtree(MADE, ignore_errors=True)
    MADE.mkdir()
    return subprocess.run(
        [SOURCE / "deploy/wheel.sh", f"--build={BIN.parent}", f"--out={MADE}", f"--python={python}"], capture_output=True, text=True,
        timeout=1500, check=False)

  @staticmethod
  def link_dependencies():
    """What pip would download."""
    site = pathlib.Path(numpy.__file__).parents[1]
    for name in ("numpy", "numpy.libs", "gymnasium", "cloudpickle", "farama_notifications", "typing_extensions.py"):
      (packages() / name).symlink_to(site / name)

  @needs_packing
  def test_a_wheel_of_this_build_is_made_and_installed(self):
    """The other cases use it."""
    made = self.make(sys.executable)
    self.assertEqual(made.returncode, 0, made.stderr)
    (wheel,) = MADE.glob("*.whl")
    self.assertRegex(wheel.name, r"^craftfleet-[\d.]+-cp3\d+-(cp3\d+|abi3)-manylinux_2_36_x86_64\.whl$")
    self.assertIn(str(wheel), made.stdout)
    self.assertLess(wheel.stat().st_size, MAX_WHEEL_BYTES)
    names = zipfile.ZipFile(wheel).namelist()
    self.assertEqual([name for name in names if OF_LIBTORCH.search(name)], [])
    self.assertEqual({name.rpartition("/")[2] for name in names if re.search(r"\.data/scripts/.", name)}, PROGRAMS)
    subprocess.run([sys.executable, "-m", "venv", ENVIRONMENT], check=True)
    subprocess.run([ENVIRONMENT / "bin/pip", "install", "--no-index", "--no-deps", wheel], check=True)
    self.link_dependencies()

  @unittest.skipIf(IS_PACKED, "a wheel of this build is made")
  def test_a_build_that_is_not_packed_is_gathered_for_the_other_cases(self):
    python = self.folder / "python3"
    python.write_text(KEEPING_PYTHON)
    python.chmod(0o755)
    made = self.make(python)
    self.assertEqual((made.returncode, made.stderr), (3, ""))
    gathered = self.folder / "gathered"
    self.assertEqual({script.name for script in (gathered / "scripts").iterdir()}, PROGRAMS)
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", ENVIRONMENT], check=True)
    for script in (gathered / "scripts").iterdir():
      script.write_text(re.sub(r"^#!python$", f"#!{ENVIRONMENT}/bin/python", script.read_text(), count=1, flags=re.MULTILINE))
      script.rename(ENVIRONMENT / "bin" / script.name)
    shutil.move(gathered / "craftfleet_programs", packages())
    shutil.move(gathered / "share", ENVIRONMENT)
    (packages() / "craftfleet").symlink_to(package.SITE / "craftfleet")
    self.link_dependencies()

  @needs_packing
  def test_programs_take_libraries_from_the_wheel_the_system_and_torch_alone(self):
    torch = pathlib.Path(self.with_torch()) / "torch/lib"
    brought = {os.path.realpath(path) for path in libraries(torch / "libtorch.so").values() if path}
    own = packages() / "craftfleet.libs"
    self.assertGreater(len(list(own.iterdir())), 20)
    for program in (packages() / "craftfleet_programs/bin").iterdir():
      for name, path in libraries(program, LD_LIBRARY_PATH=str(torch)).items():
        self.assertIsNotNone(path, f"{program.name} finds no {name}")
        inside = pathlib.Path(os.path.abspath(path)).is_relative_to(own)
        self.assertTrue(inside or OF_THE_SYSTEM.search(path) or OF_LIBTORCH.search(path) or os.path.realpath(path) in brought,
                        f"{program.name} takes {path}")

  @needs_packing
  def test_doctor_does_not_take_the_blas_of_opencv_for_that_of_libtorch(self):
    said = self.run_in_environment("craftfleet", "doctor", "--listen=", PYTHONPATH=self.with_torch())
    self.assertRegex(said, r"(?m)^ok +BLAS +")
    self.assertNotIn("craftfleet.libs", said)

  def test_without_torch_the_games_and_the_environment_server_work(self):
    for words in (["craftfleet", "envs"], ["craftfleet-envserver"], ["craftfleet", "play"], ["craftfleet", "status"], ["craftfleet", "top"]):
      self.assertIn(" ".join(words), self.run_in_environment(*words, "--version"))
    self.assertIn("crafter", self.run_in_environment("craftfleet", "envs", "--worlds=1"))
    self.assertEqual(self.run_in_environment("python", "-c", "import craftfleet; print(craftfleet.Env(seed=1).reset().shape)"), "(64, 64, 3)\n")

  def test_without_torch_training_names_the_command_that_is_missing(self):
    want = cmake_setting("CRAFTFLEET_LIBTORCH_VERSION")
    for words in (["craftfleet", "train", "--logdir=run"], ["craftfleet", "help", "train"]):
      self.assertEqual(self.run_in_environment(*words, code=1),
                       f"craftfleet train: needs torch {want}, and this Python has none: pip install 'craftfleet[train]'\n")
    said = self.run_in_environment("python", "-c", "import craftfleet; craftfleet.train(logdir='run')", code=1)
    self.assertIn(f"ModuleNotFoundError: needs torch {want}, and this Python has none: pip install 'craftfleet[train]'\n", said)
    other = self.with_torch("2.110")
    self.assertEqual(self.run_in_environment("craftfleet", "train", code=1, PYTHONPATH=other),
                     f"craftfleet train: needs torch {want}, and {other}/torch is 2.110: pip install 'craftfleet[train]'\n")
    self.assertFalse((self.folder / "run").exists())

  def test_with_torch_it_trains_as_the_build_does(self):
    (self.folder / "config.txt").write_text(SMALL_RUN)
    self.run_program("craftfleet train", f"--config={self.folder}/config.txt", f"--logdir={self.folder}/build", "--device=cpu")
    torch = self.with_torch()
    self.run_in_environment("craftfleet", "train", "--config=config.txt", "--logdir=wheel", "--device=cpu", PYTHONPATH=torch)
    self.run_in_environment(
        "python", "-c", "import craftfleet as c; print(c.evaluate(c.train(config='config.txt', logdir='python', device='cpu')).score)",
        PYTHONPATH=torch)
    fleet = ENVIRONMENT / "share/craftfleet/local-fleet.sh"
    self.run_in_environment(
        os.path.relpath(fleet, ENVIRONMENT / "bin"), "--actors=1", "--envservers=1", "--config=config.txt", "--logdir=fleet",
        "--device=cpu", PYTHONPATH=torch)
    for run in ("wheel", "python", "fleet"):
      self.assertEqual((self.folder / run / "stats.jsonl").read_bytes(), (self.folder / "build/stats.jsonl").read_bytes(), run)

  def test_scripts_experiments_and_the_licence_are_in_share(self):
    for file in ("craftfleet/slurm/fleet.sbatch", "craftfleet/make-certs.sh"):
      self.assertTrue(os.access(ENVIRONMENT / "share" / file, os.X_OK), file)
    self.assertTrue((ENVIRONMENT / "share/doc/craftfleet/LICENSE").exists())
    listed = self.run_in_environment("craftfleet", "sweep", str(ENVIRONMENT / "share/craftfleet/experiments/paper.toml"), "--list")
    self.assertIn("ppo_cnn", listed)

  def test_a_folder_without_a_build_is_refused(self):
    for flags, reason in ((["--build=/nowhere"], "--build=/nowhere: no build there"), (["--level=12"], "unknown argument '--level=12'")):
      ended = subprocess.run([SOURCE / "deploy/wheel.sh", f"--out={self.folder}", *flags], capture_output=True, text=True, check=False)
      self.assertEqual(ended.returncode, 2)
      self.assertIn(reason, ended.stderr)
    self.assertEqual(list(self.folder.iterdir()), [])


if __name__ == "__main__":
  python_case.main()
