"""Runs a test with the Python package: import it before anything that is not in the standard library.

The test goes on in the environment that `deploy/install-deps.sh --tests` makes, with the package that install_test.py has installed
in the build folder. Without either it is reported as skipped.
"""

import importlib.util
import os
import pathlib
import sys
import unittest
import warnings

from tests.fakes.python_case import BIN, SKIPPED, SOURCE

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


def need(*modules):
  """Skips the test file unless the modules are there."""
  for module in modules:
    if importlib.util.find_spec(module) is None:
      wanted = "ctest -R PythonInstall" if module == "craftfleet" else "deploy/install-deps.sh --tests"
      skip(f"no Python package {module} in {ENVIRONMENT} or {SITE}, want: {wanted}")


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
