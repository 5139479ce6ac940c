"""The events of a run, read back by the real TensorBoard."""

import os
import subprocess
import unittest

from tests.fakes import python_case

READ = """
import sys
from tensorboard.backend.event_processing import event_accumulator
events = event_accumulator.EventAccumulator(sys.argv[1], size_guidance={"histograms": 0, "scalars": 0})
events.Reload()
tags = events.Tags()
print(sorted(tags["histograms"]))
print(len(tags["scalars"]))
for tag in sorted(tags["histograms"]):
  last = events.Histograms(tag)[-1]
  print(tag, last.step, last.histogram_value.num, sum(last.histogram_value.bucket))
"""


def python_with_tensorboard():
  """The Python into which deploy/install-deps.sh --tests puts the package tensorboard."""
  python = python_case.SOURCE / ".cache/python/bin/python"
  if subprocess.run([python, "-c", "import tensorboard"], capture_output=True, check=False).returncode != 0:
    raise unittest.SkipTest("the Python package tensorboard is missing: deploy/install-deps.sh --tests installs it")
  return python


class TensorBoard(python_case.FolderCase):

  def setUp(self):
    super().setUp()
    self.python = python_with_tensorboard()

  def train(self, agent):
    """Returns the run folder."""
    (self.folder / "config.txt").write_text(python_case.SMALL_RUN + f'agent: "{agent}"')
    run = self.folder / "run"
    self.run_program("craftfleet train", f"--config={self.folder}/config.txt", f"--logdir={run}", "--threads=1")
    return run

  def read(self, program, run):
    """The lines that a Python program prints about a run."""
    ended = subprocess.run([self.python, "-c", program, str(run)], capture_output=True, text=True, check=False,
                           env={**os.environ, "PYTHONPATH": str(self.folder)})
    self.assertEqual(ended.returncode, 0, ended.stderr)
    return ended.stdout.splitlines()

  def test_it_reads_curves_and_histograms(self):
    lines = self.read(READ, self.train("ppo_cnn"))
    self.assertEqual(lines[0], "['rollout/actions', 'rollout/log_probs', 'rollout/rewards', 'rollout/values']")
    self.assertGreaterEqual(int(lines[1]), 35)
    self.assertIn("rollout/actions 192 64.0 64.0", lines)


if __name__ == "__main__":
  python_case.main()
