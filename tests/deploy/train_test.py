"""craftfleet train: runs from old weights, checkpoints that are kept, the run's id."""

import json
import re

from tests.fakes import python_case


class Train(python_case.FolderCase):

  def setUp(self):
    super().setUp()
    (self.folder / "config.txt").write_text(python_case.SMALL_RUN)

  def train(self, run, *flags, code=0):
    return self.run_program("craftfleet-train", f"--config={self.folder}/config.txt", f"--logdir={self.folder}/{run}",
                            *flags, code=code)

  def checkpoints(self, run):
    return sorted(path.name for path in (self.folder / run / "checkpoints").iterdir())

  def description(self, run):
    return json.loads((self.folder / run / "run.json").read_text())

  def test_init_from_begins_a_run_with_old_weights(self):
    self.train("old", "--steps=128")
    train = self.train("new", f"--init_from={self.folder}/old", "--seed=9", "--steps=64", "--checkpoint_every=1")
    weights = lambda run, iteration: (
        self.folder / run / f"checkpoints/iter-{iteration:08}/weights.safetensors").read_bytes()
    self.assertEqual(weights("new", 0), weights("old", 2))
    self.assertNotEqual(weights("new", 1), weights("old", 2))
    origin = f"run {self.description('old')['run_id']} after iteration 2, 128 steps"
    self.assertEqual(self.description("new")["init_from"], origin)
    self.assertIn(f"begins with the weights of {origin}", train.stderr)
    self.assertIn("\n64/64 steps", train.stdout)
    self.assertNotEqual(self.description("new")["run_id"], self.description("old")["run_id"])
    self.assertNotIn("init_from", self.description("old"))
    self.train("new", "--resume", "--seed=9", "--steps=128")  # needs the old run no more

  def test_init_from_refuses_what_does_not_fit(self):
    self.train("old", "--steps=64")
    for flags, error in [
        (["--agent=lstm_cnn", f"--init_from={self.folder}/old"], "is of agent ppo_cnn, not of lstm_cnn: name that agent"),
        ([f"--init_from={self.folder}/none"], f"--init_from: no checkpoint at {self.folder}/none"),
        ([f"--init_from={self.folder}/old", "--resume"], "--init_from begins a new run: leave --resume away"),
    ]:
      with self.subTest(flags):
        self.assertIn(error, self.train("new", *flags, code=1).stderr)
        self.assertFalse((self.folder / "new").exists())

  def test_as_many_checkpoints_are_kept_as_asked_for(self):
    self.train("run", "--checkpoint_every=1", "--keep_checkpoints=1", "--steps=192")
    few = self.checkpoints("run")
    self.assertIn("iter-00000003", few)
    self.assertLessEqual(len(few), 2, "the newest and the best")
    self.train("run", "--resume", "--checkpoint_every=2", "--keep_checkpoints=20", "--steps=512")
    many = self.checkpoints("run")
    self.assertLessEqual({"iter-00000003", "iter-00000004", "iter-00000006", "iter-00000008"}, set(many))
    self.assertNotIn("iter-00000005", many)
    self.assertIn("keep: 20", (self.folder / "run/config.txt").read_text())
    refused = self.train("run", "--resume", "--keep_checkpoints=0", code=1)
    self.assertIn("checkpoint.keep is 0, want 1..1000", refused.stderr)

  def test_the_runs_id_is_shown_everywhere(self):
    train = self.train("run")
    run_id = self.description("run")["run_id"]
    self.assertRegex(run_id, r"^\d{8}-\d{6}-[0-9a-f]{6}$")
    self.assertTrue(train.stdout.startswith(f"run {run_id}\n"), train.stdout)
    self.assertRegex(train.stderr, rf"info: run {run_id} in {re.escape(str(self.folder))}/run")
    self.assertIn(f"run {run_id} goes on", self.train("run", "--resume", "--steps=256").stderr)
    evaluated = self.run_program("craftfleet-eval", f"--checkpoint={self.folder}/run", "--episodes=1",
                                 f"--json={self.folder}/eval.json")
    self.assertIn(run_id, evaluated.stdout)
    self.assertEqual(json.loads((self.folder / "eval.json").read_text())["run_id"], run_id)


if __name__ == "__main__":
  python_case.main()
