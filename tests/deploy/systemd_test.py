"""deploy/systemd: the units are valid and hardened, and their flags exist."""

import pathlib
import re
import shutil
import subprocess
import tempfile
import unittest

from tests.deploy.flags import unknown_flags
from tests.fakes import python_case
from tests.fakes.python_case import BIN, SOURCE

UNITS = SOURCE / "deploy/systemd"
NAMES = ("craftfleet-learner.service", "craftfleet-actor@.service", "craftfleet-envserver@.service")


class Systemd(unittest.TestCase):

  def analyze(self, *arguments):
    """Runs systemd-analyze on a copy of the units that start the programs of this build."""
    if shutil.which("systemd-analyze") is None:
      self.skipTest("no systemd-analyze here")
    with tempfile.TemporaryDirectory(prefix="craftfleet-") as folder:
      shutil.copytree(UNITS, folder, dirs_exist_ok=True)
      for path in pathlib.Path(folder).glob("*.service"):
        path.write_text(path.read_text(encoding="utf-8").replace("/usr/local/bin", str(BIN)), encoding="utf-8")
      for name in NAMES:
        path = f"{folder}/{name.replace('@', '@1')}"
        yield name, subprocess.run(["systemd-analyze", *arguments, path], capture_output=True, text=True, check=False)

  def test_units_are_valid(self):
    for name, ended in self.analyze("verify"):
      self.assertEqual((ended.returncode, ended.stdout, ended.stderr), (0, "", ""), name)

  def test_units_have_few_privileges(self):
    for name, ended in self.analyze("security", "--offline=true", "--no-pager", "--threshold=20"):
      self.assertEqual(ended.returncode, 0, f"{name}: {ended.stdout[-300:]}{ended.stderr}")

  def test_flags_are_those_of_the_programs(self):
    for name in NAMES:
      unit = (UNITS / name).read_text(encoding="utf-8")
      program, line = re.search(r"^ExecStart=/usr/local/bin/(\S+) (.*)$", unit, re.MULTILINE).groups()
      file, = re.findall(r"^EnvironmentFile=/etc/craftfleet/(\S+)$", unit, re.MULTILINE)
      lines = (UNITS / file).read_text(encoding="utf-8").splitlines()
      values = dict(entry.split("=", 1) for entry in lines if not entry.startswith("#"))
      used = re.findall(r"\$\{?([A-Z]+)\}?", line)
      self.assertEqual(sorted(used), sorted(values), file)
      line = re.sub(r"\$\{?([A-Z]+)\}?", lambda found: values[found[1]], line)
      self.assertEqual(unknown_flags(program, line.split()), [], name)

  def test_systemd_never_gives_up_a_unit_that_fails_at_once(self):
    for name in NAMES:
      seconds = re.search(r"^RestartSec=(\d+)$", (UNITS / name).read_text(encoding="utf-8"), re.MULTILINE)
      self.assertGreaterEqual(5 * int(seconds[1]), 10, f"{name}: systemd refuses the sixth start within 10 s")

  def test_there_is_room_for_the_games_and_time_to_stop(self):
    gigabytes, = re.findall(r"^MemoryMax=(\d+)G$", (UNITS / NAMES[2]).read_text(encoding="utf-8"), re.MULTILINE)
    self.assertGreater(int(gigabytes) * 1024, 2048 + 512, "the defaults of --max_games_mb and --max_buffered_mb")
    for name in NAMES:
      seconds = re.search(r"^TimeoutStopSec=(\d+)$", (UNITS / name).read_text(encoding="utf-8"), re.MULTILINE)
      self.assertGreaterEqual(int(seconds[1]), 15, "a process has 10 s to stop")


python_case.main()
