"""craftfleet watch: a small run's agent in a terminal, in a window, as a video and as a strip of pictures."""

import json
import os
import shlex
import shutil
import signal
import struct
import subprocess

from tests.fakes import python_case
from tests.fakes.python_case import built
from tests.fakes.screens import Display, Tmux

WATCH = built("craftfleet watch")
RUN = python_case.SMALL_RUN.replace("steps: 192", "steps: 64")


def png_size(path):
  """Width and height of a PNG file."""
  data = path.read_bytes()
  assert data[:8] == b"\x89PNG\r\n\x1a\n"
  return struct.unpack(">II", data[16:24])


class WatchAgent(python_case.FolderCase):

  def train(self, agent="ppo_cnn"):
    """The folder of a run of one iteration."""
    return python_case.trained_run(self.folder / agent, RUN + f'agent: "{agent}"')

  def test_in_a_terminal_it_pauses_steps_and_follows_the_run(self):
    run = self.train()
    with Tmux(self.folder, shlex.join([*map(str, WATCH), "--terminal", "--follow", "--speed=1", str(run)])) as terminal:
      terminal.wait_for("seed 0, episode 1, step 1")
      terminal.press("Space")
      terminal.wait_for("PAUSED ppo_cnn")
      terminal.wait_for(" 64 steps")
      terminal.press("r")
      terminal.wait_for("episode 1, step 0")
      for step in (1, 2, 3):
        terminal.press(".")
        terminal.wait_for(f"step {step}")
      self.assertIn("make_stone_pickaxe", terminal.page())
      self.assertIn("value", terminal.page())
      self.assertGreater(len(terminal.colors()), 10)
      self.run_program("craftfleet train", "--resume", "--steps=128", f"--logdir={run}", "--threads=1")
      terminal.press("n")
      terminal.wait_for(" 128 steps")
      terminal.press("q")
      terminal.wait_for_exit(0)

  def test_in_a_window(self):
    run = self.train()
    with Display(self.folder) as display:
      process = subprocess.Popen([*WATCH, "--size=288", str(run)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
                                 env=display.environment)
      self.addCleanup(process.kill)
      window = display.window("craftfleet watch", process)
      display.press(window, "space", "period")
      display.press_until_exit(window, "Escape", process)
      output, errors = process.communicate(timeout=60)
      self.assertEqual((process.returncode, output, errors), (0, "", ""))

  def test_the_video_has_a_picture_for_each_moment(self):
    video = self.folder / "episode.mp4"
    ended = self.run_program("craftfleet watch", f"--video={video}", "--episode=3", "--size=128", str(self.train()))
    self.assertIn(f"{video}: ppo_cnn, 64 steps, episode 3, 20 steps, reward", ended.stdout)
    self.assertEqual(len(list(self.folder.glob("episode*"))), 1, "no unfinished file")
    if shutil.which("ffprobe") is None:
      self.assertGreater(video.stat().st_size, 2000)
      return
    facts = subprocess.run(["ffprobe", "-v", "error", "-count_frames", "-show_streams", "-of", "json", video], capture_output=True,
                           text=True, check=True).stdout
    self.assertEqual(json.loads(facts)["streams"][0]["nb_read_frames"], "21")

  def test_the_strip_has_two_rows_and_the_chosen_columns(self):
    run = self.train("oc_ca")
    for flags, columns in [(["--strip_steps=0,5,19"], 3), (["--strip_columns=4", "--attention=sum"], 4)]:
      strip = self.folder / "strip.png"
      ended = self.run_program("craftfleet watch", f"--strip={strip}", *flags, str(run))
      self.assertEqual(ended.stdout, f"{strip}: {columns} columns of episode 1\n")
      self.assertEqual(png_size(strip), (columns * 186 + 6, 400))

  def test_a_strip_that_is_stopped_is_not_written(self):
    run = python_case.trained_run(self.folder / "run", RUN.replace("length: 20", "length: 10000") + 'agent: "oc_ca"')
    strip = self.folder / "strip.png"
    os.mkfifo(strip)
    process = subprocess.Popen([*WATCH, f"--strip={strip}", run], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    self.addCleanup(process.kill)
    with strip.open("rb") as reader:  # both wait here for each other, before the episode begins
      process.send_signal(signal.SIGINT)
      self.assertEqual(reader.read(), b"")
    output, errors = process.communicate(timeout=60)
    self.assertEqual((process.returncode, output, errors), (130, "", "craftfleet watch: stopped before the strip was complete\n"))

  def test_bad_input_is_refused(self):
    run = self.train()
    for flags, expected in [
        ([], "0 runs, want one run or checkpoint"),
        (["--video=a.mp4", str(self.folder / "nothing")], "no checkpoint at "),
        (["--speed=1000", str(run)], "--speed=1000, want 0.25..256"),
        (["--video=a.avi", str(run)], "--video=a.avi, want a file name that ends in .mp4"),
        (["--strip=a.jpg", str(run)], "--strip=a.jpg, want a file name that ends in .png"),
        (["--strip_steps=5,3", str(run)], "--strip_steps=5,3, want auto or"),
        (["--attention=all", str(run)], "--attention: "),
        (["--strip=strip.png", str(run)], "no attention"),
        (["--video=a.mp4", "--env=minecraft", str(run)], "--env: "),
        (["--follow", f"{run}/checkpoints/iter-00000001"], "iter-00000001 is one checkpoint, want a run's folder"),
        (["--terminal", str(self.folder / "nothing")], "--terminal: standard input"),  # before the agent is loaded
    ]:
      ended = self.run_program("craftfleet watch", *flags, code=1)
      self.assertIn(expected, ended.stderr)

  def test_the_display_is_tried_before_the_agent_is_loaded(self):
    # LibTorch starts threads, and the child that tries the display must not inherit a lock of one of them.
    ended = subprocess.run([*WATCH, self.folder / "nothing"], capture_output=True, text=True, timeout=60,
                           env={**os.environ, "DISPLAY": ":987"}, check=False)
    self.assertEqual(ended.returncode, 1)
    self.assertRegex(ended.stderr, "cannot open (a window|windows)")

  def test_an_unwritable_video_leaves_nothing(self):
    run = self.train()
    (self.folder / "folder.mp4").mkdir()
    for video in ("no/video.mp4", "folder.mp4"):
      ended = self.run_program("craftfleet watch", f"--video={self.folder}/{video}", str(run), code=1)
      self.assertIn("--video: ", ended.stderr)
      self.assertIn(video, ended.stderr)
    self.assertEqual(list(self.folder.glob(".*.mp4")), [])

  def test_an_unwritable_strip_is_reported_before_the_episode(self):
    # The agent has no attention, which the episode's first frame shows.
    ended = self.run_program("craftfleet watch", f"--strip={self.folder}/no/strip.png", str(self.train()), code=1)
    self.assertIn("--strip", ended.stderr)
    self.assertNotIn("attention", ended.stderr)


if __name__ == "__main__":
  python_case.main()
