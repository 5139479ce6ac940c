"""craftfleet plan: what it prints, and when it measures."""

import json
import os

from tests.fakes import python_case
from tests.fakes.python_case import SMALL_RUN

MACHINES = ("--cores=2", "--measure_time=0.2")


class Plan(python_case.FolderCase):

  def setUp(self):
    super().setUp()
    self.config = self.folder / "config.txt"
    self.config.write_text(SMALL_RUN)
    self.addCleanup(os.environ.__setitem__, "XDG_CACHE_HOME", os.environ.get("XDG_CACHE_HOME", ""))
    os.environ["XDG_CACHE_HOME"] = str(self.folder / "cache")
    self.kept = self.folder / "cache/craftfleet/costs/ppo_cnn.json"

  def plan(self, *flags, code=0):
    return self.run_program("craftfleet", "plan", f"--config={self.config}", *MACHINES, *flags, code=code)

  def test_costs_are_measured_once_and_kept(self):
    ended = self.plan()
    self.assertIn("measuring what ppo_cnn costs here", ended.stderr)
    self.assertRegex(ended.stdout, r"Start \(synchronous\): 1 learner with [12] threads?, 1 actor with 1 thread, 1 environment server\n")
    self.assertIn(f"craftfleet train --config={self.config} ", ended.stdout)
    costs = json.loads(self.kept.read_text())
    again = self.plan("--json", "--lanes=2", "--overlap=1")
    self.assertEqual(again.stderr, "")
    self.assertEqual(json.loads(again.stdout)["costs"], costs)
    self.assertEqual(json.loads(again.stdout)["mode"], "--overlap=1")

  def test_costs_of_another_cpu_build_or_agent_are_measured_again(self):
    self.plan()
    costs = json.loads(self.kept.read_text())
    for field in ("cpu", "build", "config"):
      self.kept.write_text(json.dumps({**costs, field: "another"}))
      self.assertIn("measuring", self.plan().stderr, field)
      self.assertEqual(json.loads(self.kept.read_text())[field], costs[field])
    self.kept.write_text("torn")
    self.assertIn("measuring", self.plan().stderr)
    self.assertIn("measuring", self.plan("--measure").stderr)

  def test_given_costs_are_used_wherever_they_were_measured(self):
    given = self.folder / "costs.json"
    self.plan("--measure", f"--costs={given}")
    self.assertFalse(self.kept.exists())
    costs = {**json.loads(given.read_text()), "cpu": "another CPU", "gpu_update_us": 2.5}
    given.write_text(json.dumps(costs))
    ended = self.plan(f"--costs={given}", "--gpus=1")
    self.assertEqual(ended.stderr, "")
    self.assertIn("on one core of another CPU", ended.stdout)
    self.assertIn("2 cores and 1 GPU on one host", ended.stdout)
    given.write_text(json.dumps({**costs, "config": "another run"}))
    self.assertIn("has the costs of another run: another run; want agent:", self.plan(f"--costs={given}", code=1).stderr)

  def test_a_gpu_that_nobody_measured_is_not_guessed(self):
    ended = self.plan("--gpus=1", "--device=cpu", code=1)
    self.assertIn("--gpus=1: no update has been measured on a GPU; do so on a machine with one", ended.stderr)
    self.assertEqual(ended.stdout, "")


python_case.main()
