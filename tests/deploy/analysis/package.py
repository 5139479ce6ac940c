"""Lets tests import craftfleet.analysis from the sources, with the Python that has NumPy, pandas and matplotlib; and sample runs,
whose figures are easy to work out by hand."""

import os
import sys

from tests.fakes import python_case
from tests.fakes.python_case import BIN, SOURCE

SYSTEM_PYTHON = "/usr/bin/python3"
PAPER = str(SOURCE / "deploy/experiments/paper.toml")
FIGURES = str(SOURCE / "deploy/experiments/paper_figures.csv")
RESULTS = SOURCE / "deploy/experiments/results"
# Of 4,000 steps in rollouts of 1,000.
CONFIG = {"steps": 4000, "lanes": 10, "ppo": {"rollout_steps": 1000, "minibatch_size": 100}}

os.environ["CRAFTFLEET_BIN"] = str(BIN)
is_second = os.environ.pop("CRAFTFLEET_SECOND_PYTHON", None)
sys.path.insert(0, str(SOURCE / "deploy/python/craftfleet"))
try:
  from analysis import charts, runs  # noqa: F401  pylint: disable=unused-import
except ImportError as error:
  if is_second or not os.path.exists(SYSTEM_PYTHON):
    print(f"skipped: {error}")
    sys.exit(python_case.SKIPPED)
  os.environ["CRAFTFLEET_SECOND_PYTHON"] = "1"
  os.execv(SYSTEM_PYTHON, [SYSTEM_PYTHON, *sys.argv])

from analysis._cli import Refusal  # noqa: E402  pylint: disable=wrong-import-position
from analysis.logs import ACHIEVEMENTS  # noqa: E402  pylint: disable=wrong-import-position
from analysis.experiments import config_text, merged  # noqa: E402  pylint: disable=wrong-import-position


def same_episodes(number, unlocked, length=100):
  """Lines of a log: episodes with that reward and the first `unlocked` achievements: a score of 101^(unlocked / 22) - 1."""
  counts = ", ".join(f'"achievement_{name}": {2 if place < unlocked else 0}' for place, name in enumerate(ACHIEVEMENTS))
  return f'{{"length": {length}, "reward": {unlocked:.1f}, {counts}}}\n' * number


def write_run(folder, seed, config=None, episodes=40, unlocked=11):
  """A run whose stats.jsonl has that many episodes of 100 steps. `config` is laid over CONFIG."""
  folder.mkdir(parents=True, exist_ok=True)
  (folder / "config.txt").write_text(config_text(merged(CONFIG | {"seed": seed}, config or {})))
  (folder / "stats.jsonl").write_text(same_episodes(episodes, unlocked))


class Case(python_case.FolderCase):

  def refusal(self, call, *arguments, **named):
    with self.assertRaises(Refusal) as caught:
      call(*arguments, **named)
    return str(caught.exception)
