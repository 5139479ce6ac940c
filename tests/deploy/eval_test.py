"""craftfleet eval: replays the final evaluation of a run, with videos and files of its episodes."""

import json
import os
import pty
import shutil
import signal
import subprocess

from tests.fakes import python_case
from tests.fakes.python_case import SOURCE, built, wait_until

# Three evaluations with two episodes of each kind precede the final one.
CONFIG = """
steps: 192  lanes: 4  seed: 3  fragment_steps: 16
env { length: 90 }
ppo { rollout_steps: 64  minibatch_size: 32  epochs: 1 }
checkpoint { every_iterations: 1  keep: 20 }
eval { every_steps: 64  episodes: 2  final_episodes: 3  env: "crafter:numbers=easy-x2" seed: 5 }
"""
FINAL_ONLY = CONFIG.replace("every_steps: 64", "every_steps: 0")
NO_EVALUATION = FINAL_ONLY.replace("final_episodes: 3", "final_episodes: 0")


class Eval(python_case.FolderCase):

  def train(self, config=NO_EVALUATION, *flags):
    python_case.trained_run(self.folder / "run", config, *flags)

  def evaluate(self, *flags, code=0):
    return self.run_program("craftfleet eval", f"--checkpoint={self.folder}/run", *flags, code=code)

  def check_episodes(self, folder, log, size=64):
    checked = subprocess.run(["python3", SOURCE / "tests/actor/recording/check_episodes.py", folder, log, str(size)],
                             capture_output=True, text=True)
    self.assertEqual((checked.stdout, checked.stderr, checked.returncode), ("3 episodes agree\n", "", 0))

  def test_a_final_evaluation_that_is_the_first_is_replayed(self):
    self.train(FINAL_ONLY)
    self.evaluate("--protocol=final", f"--episodes_npz={self.folder}/npz")
    for kind in ("argmax", "sampled"):
      self.check_episodes(self.folder / "npz" / kind, self.folder / f"run/final_{kind}.jsonl")

  def test_the_final_evaluation_is_replayed(self):
    self.train(CONFIG)
    out = self.folder / "out"
    self.evaluate("--protocol=final", f"--video={out}/video", f"--episodes_npz={out}/npz", f"--out={out}.json",
                  "--size=144")
    result = json.loads((self.folder / "out.json").read_text())
    for kind in ("argmax", "sampled"):
      log = self.folder / f"run/final_{kind}.jsonl"
      self.check_episodes(out / "npz" / kind, log)
      lines = [json.loads(line) for line in log.read_text().splitlines()]
      self.assertAlmostEqual(result[kind]["length"], sum(line["length"] for line in lines) / 3)
      self.assertAlmostEqual(result[kind]["reward"], sum(line["reward"] for line in lines) / 3)
      self.assertEqual(result[kind]["deterministic"], kind == "argmax")
      videos = sorted((out / "video" / kind).iterdir())
      self.assertEqual([video.stem for video in videos], sorted(file.stem for file in (out / "npz" / kind).iterdir()))
      for video in videos:
        self.assertEqual(video.read_bytes()[4:8], b"ftyp", video)
    self.assertEqual(result["env"], "crafter:numbers=easy-x2")
    self.assertEqual(result["seed"], 5)

  def test_the_trained_agent_of_the_repository_plays_well(self):
    result = SOURCE / "deploy/experiments/results/ppo_cnn_1m/seed2"
    out = self.run_program("craftfleet eval", f"--checkpoint={result}", "--episodes=5", f"--out={self.folder}/out.json")
    run = json.loads((result / "run.json").read_text())["run_id"]
    self.assertIn(f"run {run}, ppo_cnn after 1003520 steps", out.stdout)
    reward = json.loads((self.folder / "out.json").read_text())["reward"]
    self.assertGreater(reward, 6, "random play gets 2")

  def test_a_result_does_not_say_which_episodes_its_final_evaluation_had(self):
    result = SOURCE / "deploy/experiments/results/ppo_cnn_1m/seed2"
    out = self.run_program("craftfleet eval", f"--checkpoint={result}", "--protocol=final", code=1)
    self.assertIn("a folder of results does not say which episodes the final evaluation had", out.stderr)

  def test_other_textures_than_those_of_the_run_are_reported(self):
    textures = self.folder / "textures"
    shutil.copytree(SOURCE / "envserver/textures", textures)
    shutil.copy(textures / "sand.png", textures / "stone.png")
    self.train(FINAL_ONLY, f"--textures={textures}")
    reported = "the run was played with textures "
    self.assertIn(reported, self.evaluate("--protocol=final", code=1).stderr)
    self.assertRegex(self.evaluate("--episodes=1").stderr,
                     f"{reported}[0-9a-f]{{16}}, but this program has 3024e54bf17f9958: give .*--textures")
    self.assertNotIn(reported, self.evaluate("--episodes=1", f"--textures={textures}").stderr)
    video = [f"--video={self.folder}/video.mp4", "--size=64", f"{self.folder}/run"]
    self.assertIn(reported, self.run_program("craftfleet watch", *video).stderr)
    self.assertNotIn(reported, self.run_program("craftfleet watch", f"--textures={textures}", *video).stderr)

  def test_the_textures_of_a_result_are_known(self):
    result = self.folder / "result"
    shutil.copytree(SOURCE / "deploy/experiments/results/ppo_cnn_1m/seed2", result)
    (result / "run.json").write_text('{"run_id": "a", "texture_digest": "8140aa54698876d7"}')
    out = self.run_program("craftfleet eval", f"--checkpoint={result}", "--episodes=1")
    self.assertIn("the run was played with textures 8140aa54698876d7", out.stderr)

  def test_a_damaged_result_is_refused(self):
    result = self.folder / "result"
    shutil.copytree(SOURCE / "deploy/experiments/results/ppo_cnn_1m/seed2", result)
    (result / "run.json").write_text("[]")
    out = self.run_program("craftfleet eval", f"--checkpoint={result}", code=1)
    self.assertIn("run.json has no run_id", out.stderr)
    (result / "weights.safetensors").write_bytes(b"nothing")
    (result / "run.json").write_text('{"run_id": "a"}')
    self.run_program("craftfleet eval", f"--checkpoint={result}", code=1)

  def test_recording_changes_no_result(self):
    self.train()
    flags = ["--episodes=3", "--seed=4"]
    self.evaluate(*flags, f"--out={self.folder}/plain.json")
    self.evaluate(*flags, f"--out={self.folder}/recorded.json", f"--pictures={self.folder}/pictures",
                  f"--video={self.folder}/video", "--picture_every=40", "--size=64")
    self.assertEqual((self.folder / "plain.json").read_text(), (self.folder / "recorded.json").read_text())
    pictures = sorted(file.name for file in (self.folder / "pictures").iterdir())
    self.assertIn("episode-0003-step-00040.png", pictures)
    self.assertEqual([name for name in pictures if "episode-0001" in name][:2], ["episode-0001-step-00000.png", "episode-0001-step-00040.png"])
    self.assertEqual(len(list((self.folder / "video").iterdir())), 3)

  def test_a_stop_keeps_the_episodes_that_have_finished(self):
    self.train()
    result = self.folder / "result.json"
    command = [*built("craftfleet eval"), f"--checkpoint={self.folder}/run", "--episodes=10000", f"--out={result}",
               f"--video={self.folder}/video", "--size=64"]
    evaluation = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
      wait_until(lambda: list(self.folder.glob("video/*-ach*.mp4")), "an episode's end")
      evaluation.send_signal(signal.SIGTERM)
      out, errors = evaluation.communicate(timeout=60)
    finally:
      evaluation.kill()
      evaluation.wait()
    self.assertEqual(evaluation.returncode, 130, errors)
    finished = json.loads(result.read_text())
    self.assertIn(f"stopped after {finished['episodes']} of 10000 sampled episodes", errors)
    self.assertIn(f"episodes {finished['episodes']} ", out)
    self.assertIn("Crafter score", out)
    self.assertGreaterEqual(finished["episodes"], 1)
    self.assertTrue(finished["stopped"])
    self.assertEqual(len(list((self.folder / "video").iterdir())), finished["episodes"], "no half videos")

  def test_a_terminal_shows_the_progress_in_place(self):
    self.train()
    main, terminal = pty.openpty()
    # So many that the line, which comes after 200 ms, is also seen on a quick machine.
    subprocess.run([*built("craftfleet eval"), f"--checkpoint={self.folder}/run", "--episodes=100"], stdout=subprocess.DEVNULL,
                   stderr=terminal, check=True)
    os.close(terminal)
    self.assertRegex(os.read(main, 65536).decode(), r"^(\r\x1b\[Ksampled: \d+ of 100 episodes(, \d+s left)?)+\r\x1b\[K$")

  def test_wrong_flags_are_refused(self):
    self.train()
    file = self.folder / "run/config.txt"
    for flags, error in [
        (["--protocol=last"], "--protocol=last, want final or nothing"),
        (["--protocol=final"], "the run has no final evaluation"),
        (["--protocol=final", "--episodes=3"], "omit --env, --seed, --episodes and --deterministic"),
        (["--attention=sum"], "--attention needs --video or --pictures"),
        (["--attention=most", f"--video={self.folder}/v"], '--attention: attention "most", want mean, sum or the number'),
        (["--attention=mean", f"--video={self.folder}/v"], "agent ppo_cnn has no attention to show; only oc_sa and oc_ca do"),
        (["--size=65"], "--size=65, want an even number 64..1024"),
        (["--picture_every=0"], "--picture_every=0, want 1..10000"),
        ([f"--video={file}/v"], str(file)),
    ]:
      with self.subTest(flags):
        self.assertIn(error, self.evaluate(*flags, code=1).stderr)

  def test_attention_is_shown_beside_the_game(self):
    self.train("""
      agent: "oc_ca"  network { slots: 2  frame_size: 36  patch: 12  stride: 12 }
      steps: 16  lanes: 2  fragment_steps: 8  env { length: 12 }
      ppo { rollout_steps: 16  minibatch_size: 8  epochs: 1 }  eval { every_steps: 0  final_episodes: 0 }
    """)
    pictures = self.folder / "pictures"
    self.evaluate("--episodes=1", f"--pictures={pictures}", "--attention=1", "--size=144", "--picture_every=10")
    for step in (0, 10):
      png = (pictures / f"episode-0001-step-000{step:02}.png").read_bytes()
      self.assertEqual(png[:8], b"\x89PNG\r\n\x1a\n")
      self.assertEqual((int.from_bytes(png[16:20], "big"), int.from_bytes(png[20:24], "big")), (288, 168))  # the scale is below
    refused = self.evaluate("--episodes=1", f"--pictures={pictures}", "--attention=2", code=1)
    self.assertIn("the agent has heads or slots 0..1", refused.stderr)


if __name__ == "__main__":
  python_case.main()
