"""craftfleet.train, evaluate, Run and Policy: Python starts the real programs and gets what they make."""

import contextlib
import copy
import importlib
import io
import json
import os
import pickle
import signal
import subprocess
import sys
import threading
import unittest.mock

from tests.deploy.python import package
from tests.fakes import python_case
from tests.fakes.python_case import BIN, ENDLESS, SMALL_RUN, built, wait_until

package.need("craftfleet", "numpy", "pandas", "tqdm", "tensorboard")
import craftfleet  # pylint: disable=wrong-import-position
from craftfleet import analysis  # pylint: disable=wrong-import-position
from craftfleet.analysis import collect  # pylint: disable=wrong-import-position
import numpy as np  # pylint: disable=wrong-import-position


class Case(python_case.FolderCase):

  def setUp(self):
    super().setUp()
    path = unittest.mock.patch.dict(os.environ, PATH=f"{BIN}:{os.environ['PATH']}")
    path.start()
    self.addCleanup(path.stop)
    self.config = self.folder / "config.txt"
    self.config.write_text(SMALL_RUN)

  def train(self, name="run", **flags):
    return craftfleet.train(config=self.config, logdir=self.folder / name, progress=False, **flags)

  def finished_run(self, *flags):
    return craftfleet.Run(python_case.trained_run(self.folder / "run", SMALL_RUN, *flags))


class Training(Case):

  def test_a_run_is_that_of_the_program(self):
    run = self.train(seed=5)
    self.run_program("craftfleet train", f"--config={self.config}", "--seed=5", f"--logdir={self.folder}/program")
    for file in ("stats.jsonl", "checkpoints/iter-00000003/weights.safetensors"):
      self.assertEqual((run.folder / file).read_bytes(), (self.folder / "program" / file).read_bytes(), file)
    self.assertEqual(run.score, craftfleet.score(self.folder / "program").score)
    self.assertEqual(set(run.weights), set(craftfleet.load_weights(self.folder / "program")))
    self.assertEqual(craftfleet.Run(run.folder).score, run.score)
    self.assertEqual((run.steps, run.complete, run.env, run.config["lanes"]), (192, True, "crafter", 4))
    self.assertEqual(analysis.episodes(run)["length"].mean(), craftfleet.score(run).length)

  def test_the_curves_are_those_of_tensorboard(self):
    from tensorboard.backend.event_processing import event_accumulator  # pylint: disable=import-outside-toplevel
    curves = self.finished_run().curves
    board = event_accumulator.EventAccumulator(str(self.folder / "run"))
    board.Reload()
    self.assertEqual(set(curves.columns), set(board.Tags()["scalars"]))
    self.assertEqual((list(curves.index), curves.index.name), ([64, 128, 192], "env_steps"))
    for tag in curves.columns:
      theirs = {event.step: event.value for event in board.Scalars(tag)}
      self.assertEqual(curves[tag].dropna().to_dict(), theirs, tag)
    events = self.folder / "run/events.out.tfevents.craftfleet"
    events.write_bytes(events.read_bytes()[:-1])  # as while the program writes
    self.assertGreater(len(craftfleet.load_curves(self.folder / "run")), 0)

  def test_a_refused_argument_is_a_value_error_with_the_programs_words(self):
    for flags, words in (({"steps": "many"}, r"^--steps=many, want a whole number"), ({"agent": "nobody"}, r'^agent "nobody" is unknown'),
                         ({"learning_rate": 1e-3}, r"^unknown flag 'learning_rate'.*; hyperparameters are fields .*: config=FILE"),
                         ({"log_format": "json"}, r"^log_format 'json', want 'text'")):
      with self.assertRaisesRegex(ValueError, words):
        self.train(**flags)
    with self.assertRaisesRegex(ValueError, r"^--http_listen=1\.2\.3\.4:9 "):  # refused when the run has a folder and a name
      self.train("listening", http_listen="1.2.3.4:9")
    self.finished_run()
    with self.assertRaisesRegex(ValueError, "--resume"):
      self.train()
    for path in ("nothing", "nothing/checkpoints/iter-00000001"):
      with self.assertRaisesRegex(FileNotFoundError, "nothing: no run, want a folder with config.txt"):
        craftfleet.evaluate(self.folder / path)
    with self.assertRaisesRegex(ValueError, r"^--episodes=0, want 1\.\.10000"):
      craftfleet.evaluate(self.folder / "run", episodes=0, progress=False)
    with self.assertRaisesRegex(ValueError, r"^protocol: .* run `craftfleet eval --protocol=final`"):
      craftfleet.evaluate(self.folder / "run", protocol="final", progress=False)

  def test_paths_are_given_in_any_form(self):
    run = craftfleet.train(
        config=os.fsencode(self.config), logdir=self.folder / "new", init_from=self.finished_run(), progress=False)
    self.assertIn("iteration 3", json.loads((run.folder / "run.json").read_text())["init_from"])

  def test_a_run_that_is_killed_or_stopped_on_the_way_is_a_runtime_error(self):
    self.config.write_text(ENDLESS)
    for name, words in (("KILL", "craftfleet train ended with exit code -9"),
                        ("TERM", r"/TERM: stopped after [\d,]+ of 1,000,000,000 steps; resume=True continues it")):
      folder = self.folder / name
      killer = subprocess.Popen(["sh", "-c", f"until [ -e {folder}/checkpoints/iter-00000001 ]; do sleep 0.1; done;"
                                 f"kill -{name} $(sed 's/process \\([0-9]*\\).*/\\1/' {folder}/lock)"])
      self.addCleanup(killer.wait)
      with self.assertRaisesRegex(RuntimeError, words):
        self.train(name)

  def test_an_evaluation_that_is_killed_is_a_runtime_error(self):
    run = self.finished_run()
    flag = f"--episodes_npz={self.folder}/tables"

    def kill():
      (pid,) = wait_until(lambda: python_case.processes_with(flag), "the evaluation")
      os.kill(pid, signal.SIGKILL)

    killer = threading.Thread(target=kill)
    killer.start()
    self.addCleanup(killer.join)
    with self.assertRaisesRegex(RuntimeError, "craftfleet eval ended with exit code -9"):
      craftfleet.evaluate(run, episodes=10000, episodes_npz=self.folder / "tables", progress=False)

  def test_without_programs_it_says_how_to_get_them(self):
    with unittest.mock.patch.dict(os.environ, PATH="/nowhere"), self.assertRaisesRegex(FileNotFoundError, r"craftfleet is not in PATH"):
      self.train()

  def test_ctrl_c_saves_the_run_and_it_can_be_resumed(self):
    self.config.write_text(ENDLESS)
    script = f"import craftfleet\ncraftfleet.train(config={str(self.config)!r}, logdir={str(self.folder / 'run')!r})"
    python = subprocess.Popen([sys.executable, "-c", script], stderr=subprocess.PIPE, text=True, cwd=self.folder,
                              env={**os.environ, "PYTHONPATH": str(package.SITE)})
    self.addCleanup(python.kill)
    wait_until((self.folder / "run/checkpoints/iter-00000002").exists, "two iterations")
    python.send_signal(signal.SIGINT)
    _, errors = python.communicate(timeout=60)
    self.assertEqual(python.returncode, -signal.SIGINT, errors)
    self.assertTrue(errors.rstrip().endswith("KeyboardInterrupt"), errors)
    self.assertEqual(python_case.processes_with(str(self.folder)), [])
    iterations = [int(path.name[5:]) for path in (self.folder / "run/checkpoints").iterdir()]
    last = 64 * max(iterations)
    run = self.train(resume=True, steps=last + 64)
    self.assertEqual(run.curves.index[-1], last + 64)


  def test_training_stops_when_python_is_terminated(self):
    self.config.write_text(ENDLESS)
    script = f"import craftfleet\ncraftfleet.train(config={str(self.config)!r}, logdir={str(self.folder / 'run')!r})"
    python = subprocess.Popen([sys.executable, "-c", script], stderr=subprocess.DEVNULL, cwd=self.folder,
                              env={**os.environ, "PYTHONPATH": str(package.SITE)})
    self.addCleanup(python.kill)
    wait_until((self.folder / "run/checkpoints/iter-00000002").exists, "two iterations")
    (pid,) = python_case.processes_with(f"--logdir={self.folder}/run")
    self.addCleanup(lambda: python_case.command_line(pid) and os.kill(pid, signal.SIGKILL))
    python.terminate()
    self.assertEqual(python.wait(60), -signal.SIGTERM)
    wait_until(lambda: not python_case.command_line(pid), "the end of the training")


class Progress(Case):

  def shown(self, name="run", **flags):
    output, errors = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(output), contextlib.redirect_stderr(errors):
      run = craftfleet.train(config=self.config, logdir=self.folder / name, **flags)
      craftfleet.evaluate(run, episodes=2)
    return output.getvalue(), errors.getvalue()

  def test_progress_is_a_bar_where_tqdm_is_installed(self):
    output, errors = self.shown()
    self.assertEqual(output, "")
    self.assertRegex(errors, r"100%\|.*\| 192/192 .*steps")

  def test_progress_is_a_line_elsewhere(self):
    with unittest.mock.patch.dict(sys.modules, tqdm=None), unittest.mock.patch.object(
        importlib.util, "find_spec", side_effect=lambda name, find=importlib.util.find_spec: None if name == "tqdm" else find(name)):
      output, _ = self.shown()
    self.assertRegex(output, r"(?m)^192/192 steps 100\.0% \|")

  def test_the_log_of_the_program_is_shown_as_far_as_asked_for(self):
    for level, shown in (("info", self.assertIn), ("warning", self.assertNotIn)):
      for progress in (True, False):
        _, errors = self.shown(f"run-{level}-{progress}", steps=100, log_level=level, progress=progress)
        shown("training for 128 steps instead of 100", errors)


class Evaluation(Case):

  def test_an_evaluation_is_that_of_the_program(self):
    run = self.finished_run()
    evaluated = craftfleet.evaluate(run, episodes=3, seed=4, progress=False)
    self.run_program("craftfleet eval", f"--checkpoint={run.folder}", "--episodes=3", "--seed=4", f"--out={self.folder}/program.json")
    program = json.loads((self.folder / "program.json").read_text())
    craftfleet.evaluate(run, episodes=3, seed=4, out=self.folder / "python.json", progress=False)
    self.assertEqual(json.loads((self.folder / "python.json").read_text())["score"], program["score"])
    self.assertEqual((evaluated.score, evaluated.evaluation.reward, evaluated.evaluation.episodes),
                     (program["score"], program["reward"], 3))
    self.assertEqual(evaluated.evaluation.success_rates, program["success_percentages"])
    self.assertIsNone(run.evaluation)

  def test_a_checkpoint_is_evaluated_by_its_folder(self):
    run = self.finished_run()
    checkpoint, out = run.folder / "checkpoints/iter-00000001", self.folder / "result.json"
    evaluated = craftfleet.evaluate(checkpoint, episodes=1, out=out, progress=False)
    self.assertEqual((evaluated.folder, evaluated.evaluation.episodes), (run.folder, 1))
    self.assertEqual(json.loads(out.read_text())["env_steps_trained"], 64)
    with contextlib.chdir(checkpoint):
      self.assertEqual(craftfleet.evaluate("../iter-00000002", episodes=1, out=out, progress=False).folder, run.folder)
    self.assertEqual(json.loads(out.read_text())["env_steps_trained"], 128)


class Policy(Case):

  def recorded(self, run, *flags):
    """The episodes of an evaluation with seed 7, as craftfleet eval records them."""
    tables = run.folder / "".join(["tables", *flags])
    self.run_program("craftfleet eval", f"--checkpoint={run.folder}", "--episodes=3", "--seed=7", f"--episodes_npz={tables}", *flags)
    episodes = []
    for file in sorted(tables.glob("*.npz")):
      with np.load(file) as table:
        episodes.append({name: table[name] for name in ("image", "action", "reward")})
    self.assertEqual(len(episodes), 3)
    return episodes

  def assert_plays_them_again(self, policy, episodes):
    """One after the other: row t of a table has the action that led to its image."""
    for number, episode in enumerate(episodes):
      actions = [policy(image, reward, starts=step == 0)
                 for step, (image, reward) in enumerate(zip(episode["image"][:-1], episode["reward"]))]
      self.assertEqual(actions, list(episode["action"][1:]), f"episode {number + 1}")

  def test_collected_weights_have_the_steps_of_whole_iterations(self):
    run = self.finished_run("--steps=100")
    self.assertEqual(collect.main(["--weights", str(run.folder), str(self.folder / "kept")]), 0)
    with craftfleet.Policy(self.folder / "kept") as policy:
      self.assertEqual(policy.env_steps, 128)

  def test_a_policy_plays_the_episodes_of_an_evaluation_again(self):
    run = self.finished_run()
    for flags, choice in (([], {"seed": 7}), (["--deterministic"], {"deterministic": True})):
      with self.subTest(flags), run.policy(**choice) as policy:
        self.assertEqual((policy.agent, policy.env_steps, policy.frame_size, policy.needs_rewards), ("ppo_cnn", 192, 64, False))
        self.assertEqual(policy.env, "crafter")
        self.assert_plays_them_again(policy, self.recorded(run, *flags))

  def test_agents_with_a_state_follow_their_games(self):
    for agent in ("lstm_cnn", "cnn_distillation"):
      with self.subTest(agent):
        run = self.train(agent, agent=agent)
        episodes = self.recorded(run)
        with run.policy(seed=7) as policy:
          self.assertEqual(policy.needs_rewards, agent == "cnn_distillation")
          self.assert_plays_them_again(policy, episodes)

  def test_reset_begins_new_episodes(self):
    run = self.train(agent="lstm_cnn")
    episodes = self.recorded(run)
    with run.policy(seed=7) as policy:
      for episode in episodes:
        policy.reset()
        self.assertEqual([policy(image, starts=False) for image in episode["image"][:-1]], list(episode["action"][1:]))

  def test_starts_of_a_vector_env_are_the_ends_of_the_step_that_its_autoreset_mode_says(self):
    run = self.train(agent="lstm_cnn")
    played = {"SameStep": [], "NextStep": []}
    for mode, games in played.items():
      envs = craftfleet.VectorEnv(2, length=5, autoreset_mode=mode)
      frames, _ = envs.reset(seed=0)
      starts, over = np.ones(2, bool), np.zeros(2, bool)
      with run.policy(seed=7) as policy:
        while len(games) < 15:
          actions = policy(frames, starts=starts)
          if mode == "SameStep" or not over.any():  # there the action after an end is ignored
            games.append(actions.tolist())
          before = over
          frames, _, terminated, truncated, _ = envs.step(actions)
          over = terminated | truncated
          starts = over if mode == "SameStep" else before
    self.assertEqual(played["NextStep"], played["SameStep"])

  def test_many_games_are_played_side_by_side(self):
    run = self.finished_run()
    episodes = self.recorded(run)
    steps = min(len(episode["action"]) for episode in episodes) - 1
    with run.policy(seed=7) as policy:
      for step in range(steps):
        actions = policy(np.stack([episode["image"][step] for episode in episodes]), [episode["reward"][step] for episode in episodes],
                         np.full(3, step == 0))
        self.assertEqual((actions.dtype, list(actions)), (np.int64, [episode["action"][step + 1] for episode in episodes]))

  def test_what_does_not_fit_is_refused(self):
    run = self.finished_run("--agent=cnn_distillation")
    frame = np.zeros((64, 64, 3), np.uint8)
    with run.policy() as policy:
      for arguments, words in (((frame.astype(np.float32),), "observations are float32[64, 64, 3], want uint8[64, 64, 3]"),
                               ((frame[:32],), "observations are uint8[32, 64, 3]"),
                               ((np.zeros((0, 64, 64, 3), np.uint8),), "observations of 0 games, want one or more")):
        with self.assertRaises(ValueError) as caught:
          policy(*arguments)
        self.assertIn(words, str(caught.exception))
      policy(frame)
      for arguments, words in (((frame, 0), "starts is missing: pass whether an episode begins with the observation, or call reset()"),
                               ((frame, None, False), "cnn_distillation remembers achievements: pass the rewards"),
                               ((np.stack([frame, frame]), 0, False), "observations of 2 games, want 1 as before, or a new Policy"),
                               ((frame, [0, 1], False), "rewards has shape (2,), want (1,)")):
        with self.assertRaises(ValueError) as caught:
          policy(*arguments)
        self.assertIn(words, str(caught.exception))
    with self.assertRaisesRegex(RuntimeError, "the policy is closed"):
      policy(frame, 0, False)
    (run.folder / "config.txt").unlink()
    for file in (run.folder / "checkpoints").glob("*/weights.safetensors"):
      file.write_bytes(b"")
    with self.assertRaisesRegex(ValueError, "weights.safetensors"):
      craftfleet.Policy(run.folder)

  def test_an_interrupted_call_closes_the_policy(self):
    """Its actions are not taken for those of the next call."""
    policy, frame = self.finished_run().policy(), np.zeros((64, 64, 3), np.uint8)
    process = policy._process  # pylint: disable=protected-access
    process.stdout = unittest.mock.Mock(wraps=process.stdout)
    process.stdout.read.side_effect = KeyboardInterrupt
    with self.assertRaises(KeyboardInterrupt):
      policy(frame)
    with self.assertRaisesRegex(RuntimeError, "the policy is closed"):
      policy(frame)

  def test_a_second_thread_a_fork_and_a_copy_are_refused_and_the_games_go_on(self):
    run, frame = self.finished_run(), np.zeros((64, 64, 3), np.uint8)
    policy = run.policy(seed=3)
    with run.policy(seed=3) as alone:
      expected = [alone(frame, starts=False) for _ in range(3)]
    actions = [policy(frame)]
    with policy._busy:  # pylint: disable=protected-access  # as in a call of another thread
      with self.assertRaisesRegex(RuntimeError, "another thread is in a call of this Policy"):
        policy(frame)
    if (child := os.fork()) == 0:
      try:
        policy(frame)
      except RuntimeError:
        policy.close()
        os._exit(7)
      os._exit(1)
    self.assertEqual(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), 7)
    for clone in (copy.copy, copy.deepcopy, pickle.dumps):
      with self.assertRaisesRegex(TypeError, "a Policy has a process"):
        clone(policy)
    actions += [policy(frame, starts=False), policy(frame, starts=False)]
    self.assertEqual(actions, expected)
    policy.close()
    with run.policy() as policy, self.assertRaisesRegex(ValueError, "observations of 4097 games, want at most 4096"):
      policy(np.zeros((4097, 64, 64, 3), np.uint8))

  def test_a_policy_ends_with_its_program(self):
    policy = self.finished_run().policy()
    pid = policy._process.pid  # pylint: disable=protected-access
    os.kill(pid, signal.SIGKILL)
    with self.assertRaisesRegex(RuntimeError, "craftfleet policy ended with exit code -9"):
      policy(np.zeros((64, 64, 3), np.uint8))
    policy.close()


class PolicyProgram(Case):

  def test_bad_requests_are_refused(self):
    run = self.finished_run()
    frame = bytes(1 + 4 + 64 * 64 * 3)
    one, two = (games.to_bytes(4, "little") for games in (1, 2))
    for request, words in ((b"", ""), (one + frame, ""), (b"\1", "the input ends within a request"),
                           (one + frame[:-1], "the input ends within a request"), (bytes(4), "0 games in a request, want 1..4096"),
                           (one + frame + two + 2 * frame, "2 games in a request after 1")):
      ended = subprocess.run([*built("craftfleet policy"), f"--checkpoint={run.folder}"], input=request, capture_output=True, check=False)
      self.assertEqual((ended.returncode, ended.stderr.decode()), (1, f"craftfleet policy: {words}\n") if words else (0, ""))
    ended = self.run_program("craftfleet policy", code=1)
    self.assertIn("--checkpoint is missing", ended.stderr)


if __name__ == "__main__":
  python_case.main()
