"""The Python package is built and installed as a user does it. The other tests of the package use what this one installs."""

import re
import shutil
import subprocess
import sys
import tarfile
import unittest

from tests.deploy.python import package
from tests.fakes import python_case
from tests.fakes.python_case import SOURCE

package.need("scikit_build_core", "nanobind", "numpy", "gymnasium", "matplotlib")
SOURCES = SOURCE / "deploy/python"
MAX_WHEEL_BYTES = 3 << 20


def pip(*arguments):
  return subprocess.run(
      [sys.executable, "-m", "pip", *arguments], capture_output=True, text=True, timeout=900, check=False, cwd=package.BUILD)


class Install(python_case.FolderCase):

  def test_the_package_installs_from_the_checkout(self):
    """What build tools it needs is in the environment already, so nothing is downloaded; a later build compiles what changed."""
    package.BUILD.mkdir(parents=True, exist_ok=True)
    made = pip(
        "wheel", "--no-deps", "--no-build-isolation", "--no-index", "--wheel-dir", self.folder,
        f"--config-settings=build-dir={package.BUILD / 'build'}", SOURCES)
    self.assertEqual(made.returncode, 0, made.stdout + made.stderr)
    (wheel,) = self.folder.glob("craftfleet-*.whl")
    self.assertLess(wheel.stat().st_size, MAX_WHEEL_BYTES)
    shutil.rmtree(package.SITE, ignore_errors=True)
    installed = pip("install", "--no-deps", "--no-index", "--target", package.SITE, wheel)
    self.assertEqual(installed.returncode, 0, installed.stdout + installed.stderr)
    files = {path.name for path in (package.SITE / "craftfleet").iterdir()}
    self.assertLessEqual({"py.typed", "_engine.pyi", "env.py"}, files)
    self.assertTrue(list(package.SITE.glob("craftfleet-*.dist-info/licenses/LICENSE")))

  def test_a_source_distribution_has_all_of_the_game(self):
    made = subprocess.run(
        [sys.executable, "-c", f"import scikit_build_core.build as b; b.build_sdist({str(self.folder)!r})"], cwd=SOURCES,
        capture_output=True, text=True, timeout=300, check=False)
    self.assertEqual(made.returncode, 0, made.stderr)
    (archive,) = self.folder.glob("craftfleet-*.tar.gz")
    with tarfile.open(archive) as tar:
      tar.extractall(self.folder, filter="data")
    (unpacked,) = self.folder.glob("craftfleet-*/")
    configured = subprocess.run(
        ["cmake", "-S", unpacked, "-B", self.folder / "build", "-G", "Ninja", f"-Dnanobind_DIR={self.nanobind()}",
         f"-DPython_EXECUTABLE={sys.executable}", "-DSKBUILD_METADATA_DIR=."], capture_output=True, text=True, timeout=300,
        check=False)
    self.assertEqual(configured.returncode, 0, configured.stderr)
    sources = (self.folder / "build/build.ninja").read_text()
    self.assertIn(f"{unpacked.name}/repository/envserver/world/world.cc", sources)
    self.assertNotIn(str(SOURCE / "envserver"), sources)

  @staticmethod
  def nanobind():
    return subprocess.run(
        [sys.executable, "-m", "nanobind", "--cmake_dir"], capture_output=True, text=True, check=True).stdout.strip()

  def test_its_version_is_that_of_the_programs(self):
    version = re.search(r"project\(craftfleet VERSION ([\d.]+)", (SOURCE / "CMakeLists.txt").read_text())[1]
    self.assertIn(f'\nversion = "{version}"\n', (SOURCES / "pyproject.toml").read_text())
    self.assertIn(f'\n__version__ = "{version}"\n', (SOURCES / "craftfleet/__init__.py").read_text())


if __name__ == "__main__":
  python_case.main()
