"""craftfleet train: runs that start from old weights, the number of kept checkpoints, the run's id."""

import json
import re
import shutil

from tests.fakes import python_case


class Train(python_case.FolderCase):

  def setUp(self):
    super().setUp()
    (self.folder / "config.txt").write_text(python_case.SMALL_RUN)

  def train(self, run, *flags, code=0):
    return self.run_program("craftfleet train", f"--config={self.folder}/config.txt", f"--logdir={self.folder}/{run}",
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
    self.assertIn(f"starting with the weights of {origin}", train.stderr)
    self.assertIn("\n64/64 steps", train.stdout)
    self.assertNotEqual(self.description("new")["run_id"], self.description("old")["run_id"])
    self.assertNotIn("init_from", self.description("old"))
    self.train("new", "--resume", "--seed=9", "--steps=128")  # no longer needs the old run

  def test_init_from_refuses_what_does_not_fit(self):
    self.train("old", "--steps=64")
    for flags, error in [
        (["--agent=lstm_cnn", f"--init_from={self.folder}/old"], "is of agent ppo_cnn, not of lstm_cnn: name that agent"),
        ([f"--init_from={self.folder}/none"], f"--init_from: no checkpoint at {self.folder}/none"),
        ([f"--init_from={self.folder}/old", "--resume"], "--init_from starts a new run and cannot be combined with --resume"),
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

  def test_steps_are_rounded_up_to_whole_iterations(self):
    train = self.train("run", "--steps=0.1k")
    self.assertIn("training for 128 steps instead of 100: whole iterations of 64 steps", train.stderr)
    self.assertIn("\n128/128 steps 100.0%", train.stdout)
    self.assertNotIn("instead of", self.train("exact", "--steps=128").stderr)

  def test_a_run_cannot_be_resumed_to_fewer_steps_than_it_has(self):
    self.train("run")
    before = (self.folder / "run/config.txt").read_text()
    again = self.train("run", "--resume", "--steps=64", code=1)
    self.assertIn("--steps=64: the run has 192 steps already; want more", again.stderr)
    self.assertEqual((self.folder / "run/config.txt").read_text(), before)
    whole = self.train("run", "--resume", "--steps=190")
    self.assertIn("the run has 192 steps already, and 190 were requested", whole.stderr)

  def test_autoresume_starts_a_run_again_that_has_no_checkpoint(self):
    self.train("run")
    weights = (self.folder / "run/checkpoints/iter-00000003/weights.safetensors").read_bytes()
    shutil.rmtree(self.folder / "run/checkpoints")  # as if killed before the first checkpoint
    for log in [*(self.folder / "run").glob("*.jsonl"), *(self.folder / "run").glob("*tfevents*")]:
      log.write_bytes(b"")
    again = self.train("run", "--autoresume")
    self.assertIn("the run is complete", again.stderr)
    self.assertEqual((self.folder / "run/checkpoints/iter-00000003/weights.safetensors").read_bytes(), weights)

  def test_a_run_whose_checkpoints_are_away_is_not_overwritten(self):
    self.train("run")
    checkpoints = self.folder / "run/checkpoints"
    checkpoints.rename(self.folder / "away")
    contents = lambda: {path: path.read_bytes() for path in checkpoints.parent.iterdir() if path.is_file() and path.name != "lock"}
    before = contents()
    def refused(reason):
      for flags in ([], ["--autoresume"]):
        self.assertIn(reason, self.train("run", *flags, code=1).stderr)
        self.assertEqual(contents(), before)
    refused("put its checkpoints back")
    checkpoints.symlink_to("nowhere")
    refused(f"cannot list {checkpoints}: No such file or directory")
    checkpoints.unlink()
    (self.folder / "away").rename(checkpoints)
    self.train("run", "--autoresume")

  def test_the_runs_id_is_shown_everywhere(self):
    train = self.train("run")
    run_id = self.description("run")["run_id"]
    self.assertRegex(run_id, r"^\d{8}-\d{6}-[0-9a-f]{6}$")
    self.assertTrue(train.stdout.startswith(f"run {run_id}\n"), train.stdout)
    self.assertRegex(train.stderr, rf"info: run {run_id} in {re.escape(str(self.folder))}/run")
    self.assertIn(f"run {run_id} resumes", self.train("run", "--resume", "--steps=256").stderr)
    evaluated = self.run_program("craftfleet eval", f"--checkpoint={self.folder}/run", "--episodes=1",
                                 f"--out={self.folder}/eval.json")
    self.assertIn(run_id, evaluated.stdout)
    self.assertEqual(json.loads((self.folder / "eval.json").read_text())["run_id"], run_id)


if __name__ == "__main__":
  python_case.main()
