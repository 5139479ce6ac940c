"""Runs a test with the Python package: import it before anything that is not in the standard library.

The test goes on in the environment that `deploy/install-deps.sh --tests` makes, with the package that install_test.py has installed
in the build folder. Without either it is reported as skipped.
"""

import importlib.util
import os
import pathlib
import re
import subprocess
import sys
import unittest
import warnings

from tests.fakes.python_case import BIN, SKIPPED, SOURCE

EXAMPLES = SOURCE / "deploy/python/examples"
ENVIRONMENT = SOURCE / ".cache/python"
BUILD = BIN.parent / "python"
SITE = BUILD / "site"


def skip(reason):
  print("skipped:", reason)
  sys.exit(SKIPPED)


def enter():
  """Continues this process in the environment."""
  if pathlib.Path(sys.prefix) == ENVIRONMENT:
    return
  python = ENVIRONMENT / "bin/python3"
  if not python.exists():
    skip("the Python packages are missing, want: deploy/install-deps.sh --tests")
  os.execv(python, [str(python), *sys.orig_argv[1:]])


def need(*modules, torch=()):
  """Skips the test file unless the modules are there; those of `torch` are installed by --tests=torch only."""
  for module in (*modules, *torch):
    if importlib.util.find_spec(module) is None:
      wanted = f"deploy/install-deps.sh --tests{'=torch' if module in torch else ''}"
      if module == "craftfleet":
        wanted = "ctest -R PythonInstall"
      skip(f"no Python package {module} in {ENVIRONMENT} or {SITE}, want: {wanted}")


def run_example(name, *changed, cwd):
  """Runs an example with the flags of its command in examples/README.md, some of them `changed`; returns the ended process."""
  (flags,) = re.findall(
      rf"^    venv/bin/python deploy/python/examples/{name}(.*)$", (EXAMPLES / "README.md").read_text(), re.MULTILINE)
  return subprocess.run(
      [sys.executable, EXAMPLES / name, *flags.split(), *changed], capture_output=True, text=True, timeout=600, check=False, cwd=cwd,
      env={**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(SITE)})


class PackageCase(unittest.TestCase):
  """Warnings are errors."""

  def setUp(self):
    catcher = warnings.catch_warnings()
    catcher.__enter__()  # pylint: disable=unnecessary-dunder-call  # left by the cleanup
    self.addCleanup(catcher.__exit__, None, None, None)
    warnings.simplefilter("error")

  def assert_refused(self, kind, text, call, *arguments, **named):
    """`call` raises exactly `kind`, with `text` in its message."""
    with self.assertRaises(kind) as caught:
      call(*arguments, **named)
    self.assertIs(type(caught.exception), kind)
    self.assertIn(text, str(caught.exception))


enter()
sys.path.insert(0, str(SITE))
