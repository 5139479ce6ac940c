"""Helpers for Python tests of programs and scripts.

A test file ends with `python_case.main()` and is run with the names of its cases, like `test_ends_with_the_run`, or
without any for all of them. Environment: CRAFTFLEET_BIN_DIR, CRAFTFLEET_SOURCE_DIR.
"""

import atexit
import functools
import os
import pathlib
import re
import shutil
import socket
import subprocess
import sys
import tempfile
import time
import unittest

BIN = pathlib.Path(os.environ.get("CRAFTFLEET_BIN_DIR", "build/bin")).resolve()
SOURCE = pathlib.Path(os.environ.get("CRAFTFLEET_SOURCE_DIR", ".")).resolve()
SKIPPED = 77  # the exit code that CTest counts as skipped

# Three iterations of 64 steps on 4 lanes, with a checkpoint after each: takes a few seconds.
SMALL_RUN = """
steps: 192  lanes: 4  seed: 3  fragment_steps: 16
env { length: 20 }
ppo { rollout_steps: 64  minibatch_size: 32  epochs: 1 }
checkpoint { every_iterations: 1  keep: 20 }
eval { every_steps: 0  final_episodes: 0 }
"""

# The same, which does not end during a test.
ENDLESS = SMALL_RUN.replace("steps: 192 ", "steps: 1000000000 ")

# The small run as an experiment with a single cell.
SMALL_EXPERIMENT = """
[[experiments]]
name = "small"
[experiments.base]
steps = 192
lanes = 4
fragment_steps = 16
env = { length = 20 }
ppo = { rollout_steps = 64, minibatch_size = 32, epochs = 1 }
checkpoint = { every_iterations = 1, keep = 20 }
eval = { every_steps = 0, final_episodes = 0 }
"""


def built(name):
  """The words that start a program of this build, such as "craftfleet-actor" or "craftfleet train"."""
  program, *command = name.split()
  return [BIN / program, *command]


def cmake_setting(name):
  """The value of a variable in this build's CMake cache."""
  text = (BIN.parent / "CMakeCache.txt").read_text(encoding="utf-8")
  return re.search(rf"^{name}:[A-Z]*=(.*)$", text, re.MULTILINE)[1]


def trained_run(folder, config, *flags):
  """Makes `folder` a finished run: a copy of one that this process trains only once with these arguments. Returns it."""
  return shutil.copytree(_trained_once(config, flags), folder)


@functools.cache
def _trained_once(config, flags):
  folder = pathlib.Path(tempfile.mkdtemp(prefix="craftfleet-"))
  atexit.register(shutil.rmtree, folder)
  (folder / "config.txt").write_text(config, encoding="utf-8")
  ended = subprocess.run([*built("craftfleet train"), f"--config={folder}/config.txt", f"--logdir={folder}/run", "--threads=1", *flags],
                         capture_output=True, text=True, timeout=120, check=False)
  assert ended.returncode == 0, ended.stderr
  return folder / "run"


class FolderCase(unittest.TestCase):
  """A test case with a temporary folder, removed at its end."""

  def setUp(self):
    temp = tempfile.TemporaryDirectory(prefix="craftfleet-")
    self.addCleanup(temp.cleanup)
    self.folder = pathlib.Path(temp.name)

  def run_program(self, name, *flags, code=0):
    """Runs the program to its end and returns the completed process; fails unless its exit code is `code`."""
    ended = subprocess.run([*built(name), *flags], capture_output=True, text=True, timeout=120)
    self.assertEqual(ended.returncode, code, ended.stderr)
    return ended


class ProcessCase(FolderCase):
  """A test case with programs in the background, killed at its end."""

  def setUp(self):
    super().setUp()
    self.programs = 0  # started so far

  def start(self, name, *flags):
    """Starts a program; returns it and its log file."""
    self.programs += 1
    log = self.folder / f"{self.programs}-{name.replace(' ', '-')}.log"
    with open(log, "w", encoding="utf-8") as errors:
      process = subprocess.Popen([*built(name), *flags], stdout=subprocess.DEVNULL, stderr=errors)
    self.addCleanup(process.wait)
    self.addCleanup(process.kill)
    return process, log

  def word_after(self, log, before):
    """Waits for a line of the log with `before`, and returns what follows it: "127.0.0.1:41234" after "listening on "."""
    found = wait_until(lambda: re.search(re.escape(before) + r"([^\s\"]+)", log.read_text()), f"'{before}' in {log}")
    return found.group(1)


def free_port():
  """A port of 127.0.0.1 that nothing uses yet."""
  with socket.socket() as listener:
    listener.bind(("127.0.0.1", 0))
    return listener.getsockname()[1]


def wait_until(condition, what, seconds=60):
  """Waits until `condition()` is true and returns its value; fails naming `what` after `seconds`."""
  end = time.monotonic() + seconds
  while True:
    value = condition()
    if value:
      return value
    if time.monotonic() > end:
      raise AssertionError(f"not within {seconds} s: {what}")
    time.sleep(0.02)


def command_line(pid):
  """The arguments of a process, joined by spaces; "" if it has ended."""
  try:
    return pathlib.Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
  except OSError:
    return ""


def processes_with(text):
  """Ids of the running processes, except this one, with `text` in their command line."""
  pids = [int(entry.name) for entry in pathlib.Path("/proc").iterdir() if entry.name.isdigit()]
  return [pid for pid in pids if pid != os.getpid() and text in command_line(pid)]


def main():
  """Runs the cases named on the command line; exits with SKIPPED if every one was skipped. Without names it runs all cases and
  ends with a summary like GoogleTest's, which deploy/test.sh counts."""
  module = sys.modules["__main__"]
  named = sys.argv[1:]
  classes = [item for item in vars(module).values() if isinstance(item, type) and issubclass(item, unittest.TestCase)]
  suite = unittest.TestSuite(
      case for kind in classes for case in unittest.defaultTestLoader.loadTestsFromTestCase(kind)
      if not named or case.id().rsplit(".", 1)[-1] in named)
  count = suite.countTestCases()
  result = unittest.TextTestRunner(verbosity=2).run(suite)
  if not result.wasSuccessful() or count == 0:
    sys.exit(1)
  for _, reason in result.skipped:
    print("skipped:", reason)
  if named:
    sys.exit(SKIPPED if len(result.skipped) == count else 0)
  print(f"[  PASSED  ] {count - len(result.skipped)} tests.")
  if result.skipped:
    print(f"[  SKIPPED ] {len(result.skipped)} tests, listed below:")
    for case, _ in result.skipped:
      print(f"[  SKIPPED ] {case.id()}")
