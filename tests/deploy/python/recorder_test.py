"""craftfleet.Recorder writes what the original's writes; score() and load_weights() read runs."""

import contextlib
import copy
import gzip
import importlib.util
import json
import os
import pathlib
import shutil
import subprocess
import sys
import tempfile
import threading
import unittest
import unittest.mock
import warnings

from tests.deploy.python import package
from tests.fakes import full_disk, python_case
from tests.fakes.python_case import SOURCE

package.need("craftfleet", "numpy")
import craftfleet  # pylint: disable=wrong-import-position
import gymnasium  # pylint: disable=wrong-import-position
import numpy as np  # pylint: disable=wrong-import-position

ARGUMENTS = {"seed": 12, "length": 15, "reward": False}


class FolderCase(package.PackageCase):

  def setUp(self):
    super().setUp()
    temp = tempfile.TemporaryDirectory(prefix="craftfleet-")
    self.addCleanup(temp.cleanup)
    self.folder = pathlib.Path(temp.name)


def play(env, episodes):
  for episode in range(episodes):
    env.reset()
    done, step = False, 0
    while not done:
      _, _, *ends, _ = env.step((7 * step + episode) % 17)
      done, step = any(ends), step + 1


def with_header(header):
  """A safetensors file of 8 bytes."""
  return len(header).to_bytes(8, "little") + header + bytes(8)


def tensor(shape):
  return b'{"w": {"dtype": "F32", "data_offsets": [0, 8], "shape": %s}}' % shape


class Recorder(FolderCase):

  @unittest.skipUnless(importlib.util.find_spec("crafter"), "no package crafter, want: deploy/install-deps.sh --tests")
  def test_its_files_have_what_those_of_the_original_have(self):
    import crafter  # pylint: disable=import-outside-toplevel
    for kind, folder in ((craftfleet.Recorder, "ours"), (crafter.Recorder, "theirs")):
      play(kind(craftfleet.Env(**ARGUMENTS), self.folder / folder, save_video=False), 1)
    ours, theirs = ((self.folder / folder / "stats.jsonl").read_bytes() for folder in ("ours", "theirs"))
    self.assertEqual(ours, theirs)
    (mine,), (original,) = (sorted((self.folder / folder).glob("*.npz")) for folder in ("ours", "theirs"))
    self.assertRegex(mine.name, r"^\d{8}T\d{6}-ach\d+-len15\.npz$")
    self.assertEqual(mine.name[15:], original.name[15:])
    with np.load(mine) as mine, np.load(original) as original:
      self.assertEqual(set(mine), set(original))
      for name in original:
        self.assertEqual(mine[name].dtype, original[name].dtype, name)
        self.assertTrue(np.array_equal(mine[name], original[name]), name)

  def test_each_episode_has_a_line_and_a_table_of_its_own(self):
    play(craftfleet.Recorder(craftfleet.Env(**ARGUMENTS), self.folder, save_video=False), 4)
    lines = [json.loads(line) for line in (self.folder / "stats.jsonl").read_text().splitlines()]
    self.assertEqual([line["length"] for line in lines], [15] * 4)
    self.assertEqual(len(list(self.folder.glob("*.npz"))), 4)
    self.assertEqual(craftfleet.score(self.folder).episodes, 4)

  @unittest.skipUnless(importlib.util.find_spec("imageio_ffmpeg"), "no imageio[ffmpeg], want: deploy/install-deps.sh --tests")
  def test_a_video_has_a_picture_for_each_moment_and_an_unfinished_one_is_dropped(self):
    import imageio.v2 as imageio  # pylint: disable=import-outside-toplevel
    env = craftfleet.Recorder(craftfleet.Env(**ARGUMENTS), self.folder, save_stats=False, save_episode=False, video_size=144)
    play(env, 1)
    env.reset()
    env.step(0)
    env.close()
    (video,) = self.folder.iterdir()
    self.assertRegex(video.name, r"^\d{8}T\d{6}-ach\d+-len15\.mp4$")
    with imageio.get_reader(video) as frames:
      pictures = [np.asarray(frame) for frame in frames]
    self.assertEqual({picture.shape for picture in pictures}, {(144, 144, 3)})
    self.assertEqual(len(pictures), 16)

  @unittest.skipUnless(importlib.util.find_spec("imageio_ffmpeg"), "no imageio[ffmpeg], want: deploy/install-deps.sh --tests")
  def test_a_recorder_that_nobody_closes_leaves_no_unfinished_video(self):
    code = f"import craftfleet; env = craftfleet.Recorder(craftfleet.Env(), {str(self.folder)!r}); env.reset(); env.step(0)"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=120, env={**os.environ, "PYTHONPATH": str(package.SITE)})
    self.assertEqual(list(self.folder.iterdir()), [])

  @unittest.skipUnless(importlib.util.find_spec("imageio_ffmpeg"), "no imageio[ffmpeg], want: deploy/install-deps.sh --tests")
  def test_a_fork_during_an_episode_neither_holds_up_nor_changes_its_video(self):
    import imageio_ffmpeg  # pylint: disable=import-outside-toplevel
    warnings.simplefilter("ignore", DeprecationWarning)  # newer Pythons warn of a fork beside any thread
    env = craftfleet.Recorder(craftfleet.Env(**ARGUMENTS), self.folder, save_episode=False, video_size=144)
    env.reset()
    stopped, stop = os.pipe()
    played, tell = os.pipe()
    if (child := os.fork()) == 0:
      try:
        os.close(stop)
        for _ in range(15):
          env.step(1)
        os.write(tell, b"x")
        os.read(stopped, 1)  # lives on until the test ends
      finally:
        os._exit(0)
    for end in (stopped, played):
      self.addCleanup(os.close, end)
    self.addCleanup(os.waitpid, child, 0)
    self.addCleanup(os.close, stop)
    os.close(tell)
    self.assertEqual(os.read(played, 1), b"x", "the fork has failed")
    for _ in range(15):
      env.step(0)
    self.assertEqual(craftfleet.score(self.folder).episodes, 1)
    (video,) = self.folder.glob("*.mp4")
    self.assertEqual(imageio_ffmpeg.count_frames_and_secs(video)[0], 16)
    self.assertEqual(len(list(self.folder.iterdir())), 2, "nothing else is left")

  @unittest.skipUnless(importlib.util.find_spec("imageio_ffmpeg"), "no imageio[ffmpeg], want: deploy/install-deps.sh --tests")
  def test_bad_video_sizes_and_an_ffmpeg_that_does_not_start_leave_no_files(self):
    for kind in (craftfleet.Env, craftfleet.GymnasiumEnv):
      for size, text in ((4, "video_size 4: picture width 4, want 18..2048 pixels"),
                         ((64, 3000), "picture height 3000, want 18..2048")):
        self.assert_refused(ValueError, text, craftfleet.Recorder, kind(), self.folder, video_size=size)
    with unittest.mock.patch.dict(os.environ, IMAGEIO_FFMPEG_EXE="/nowhere/ffmpeg"):
      env = craftfleet.Recorder(craftfleet.Env(), self.folder)
    self.assert_refused(FileNotFoundError, "/nowhere/ffmpeg", env.reset)
    self.assertEqual(list(self.folder.iterdir()), [])

  def test_a_relative_folder_is_that_of_the_place_where_it_was_made(self):
    with contextlib.chdir(self.folder):
      env = craftfleet.Recorder(craftfleet.Env(**ARGUMENTS), "recordings", save_video=False)
      env.reset()
      env.step(0)
    while not env.step(0)[2]:
      pass
    self.assertEqual(craftfleet.score(self.folder / "recordings").episodes, 1)

  def test_a_copy_of_a_recorder_of_env_plays_a_game_of_its_own(self):
    env = craftfleet.Recorder(craftfleet.Env(**ARGUMENTS), self.folder, save_video=False)
    env.reset()
    before = env.snapshot()
    clone = copy.copy(env)
    while not clone.step(0)[2]:
      pass
    self.assertEqual(env.snapshot(), before)
    self.assertEqual(craftfleet.score(self.folder).episodes, 1)
    play(env, 1)
    self.assertEqual(craftfleet.score(self.folder).episodes, 2)

  def test_the_game_is_the_same_with_a_recorder(self):
    plain, recorded = craftfleet.Env(**ARGUMENTS), craftfleet.Env(**ARGUMENTS)
    play(plain, 2)
    play(craftfleet.Recorder(recorded, self.folder, save_video=False), 2)
    self.assertEqual(plain.snapshot(), recorded.snapshot())

  def test_a_table_keeps_what_it_was_given(self):
    plain, written = (craftfleet.Recorder(craftfleet.Env(**ARGUMENTS), self.folder / name, save_video=False) for name in "ab")
    for recorder in (plain, written):
      observation = recorder.reset()
      done = False
      while not done:
        if recorder is written:
          observation[...] = 0
        observation, _, done, info = recorder.step(0)
        if recorder is written:
          info["player_pos"][...] = -1
          info["semantic"][...] = 0
    tables = [np.load(next((self.folder / name).glob("*.npz"))) for name in "ab"]
    for name in ("image", "player_pos", "semantic"):
      self.assertEqual(tables[0][name].tobytes(), tables[1][name].tobytes(), name)

  def recorded(self, **named):
    return craftfleet.Recorder(gymnasium.make("CraftFleet/Crafter-v1", length=15), self.folder, **named)

  def test_it_is_a_wrapper_that_gymnasiums_own_wrappers_take(self):
    env = self.recorded(save_video=False)
    self.assertIsInstance(env, gymnasium.Wrapper)
    wrapped = gymnasium.wrappers.RecordEpisodeStatistics(
        gymnasium.wrappers.FrameStackObservation(gymnasium.wrappers.TimeLimit(env, 10), 2))
    observation, _ = wrapped.reset(seed=12)
    self.assertEqual(observation.shape, (2, 64, 64, 3))
    for _ in range(10):
      *_, truncated, info = wrapped.step(0)
    self.assertTrue(truncated)
    self.assertEqual(info["episode"]["l"], 10)
    self.assertEqual(wrapped.unwrapped.snapshot(), env.unwrapped.snapshot())
    self.assertFalse((self.folder / "stats.jsonl").exists(), "its own episode goes on")
    inner = craftfleet.Recorder(gymnasium.wrappers.TimeLimit(gymnasium.make("CraftFleet/Crafter-v1"), 10), self.folder)
    play(inner, 1)
    self.assertEqual(craftfleet.score(self.folder).length, 10)

  def test_steps_after_the_end_are_not_recorded(self):
    for number, env in enumerate((craftfleet.Env(**ARGUMENTS), gymnasium.make("CraftFleet/Crafter-v1", length=15).unwrapped)):
      folder = self.folder / str(number)
      env = craftfleet.Recorder(env, folder)
      play(env, 1)
      before = sorted(path.name for path in folder.iterdir())
      for _ in range(3):
        env.step(0)
      env.close()
      self.assertEqual(sorted(path.name for path in folder.iterdir()), before)
      self.assertEqual(craftfleet.score(folder).episodes, 1)

  def test_an_environment_that_has_begun_already_is_recorded_from_its_next_episode(self):
    env = craftfleet.Env(**ARGUMENTS)
    env.reset()
    env = craftfleet.Recorder(env, self.folder, save_video=False)
    env.step(0)
    play(env, 1)
    self.assertEqual(craftfleet.score(self.folder).length, 15)

  def test_recorders_that_share_a_folder_keep_their_files_apart(self):
    threads = [
        threading.Thread(target=play, args=(craftfleet.Recorder(craftfleet.Env(**ARGUMENTS), self.folder, video_size=(64, 64)), 3))
        for _ in range(4)]
    for thread in threads:
      thread.start()
    for thread in threads:
      thread.join()
    self.assertEqual(craftfleet.score(self.folder).episodes, 12)
    tables = {path.stem for path in self.folder.glob("[0-9]*.npz")}
    self.assertEqual(len(tables), 12)
    self.assertEqual({path.stem for path in self.folder.glob("[0-9]*.mp4")}, tables)
    self.assertEqual(len(list(self.folder.iterdir())), 25, "nothing else is left")
    for table in self.folder.glob("*.npz"):
      with np.load(table) as columns:
        self.assertEqual(len(columns["image"]), 16)

  def test_on_a_full_disk_no_half_file_has_a_final_name(self):
    for what in ({"save_stats": False, "save_video": False}, {"save_stats": False, "save_episode": False},
                 {"save_video": False, "save_episode": False}):
      with self.subTest(what), full_disk.small_disk(self) as disk:
        env = craftfleet.Recorder(craftfleet.Env(**ARGUMENTS, size=(512, 512)), disk / "out", **what)
        full_disk.fill(disk)
        with self.assertRaises(OSError):
          play(env, 1)
        env.close()
        self.assertEqual([path.name for path in (disk / "out").iterdir() if path.stat().st_size > 0], [])

  def test_an_environment_of_many_games_is_refused(self):
    self.assert_refused(TypeError, "VectorEnv plays many games", craftfleet.Recorder, craftfleet.VectorEnv(2), self.folder)

  def test_an_environment_of_another_package_is_refused(self):
    self.assert_refused(TypeError, "CartPoleEnv is no environment of craftfleet", craftfleet.Recorder, gymnasium.make("CartPole-v1"),
                        self.folder)
    self.assert_refused(TypeError, "Case is no environment of craftfleet", craftfleet.Recorder, type("Case", (), {})(), self.folder)

  def test_a_subclass_is_a_wrapper_or_is_refused(self):
    class Mine(craftfleet.Recorder):
      pass
    self.assertIsInstance(Mine(craftfleet.GymnasiumEnv(), None), Mine)
    self.assert_refused(TypeError, "Mine of Env, want an environment of Gymnasium", Mine, craftfleet.Env(), None)

  def test_an_episode_that_was_restored_is_not_recorded(self):
    for env in (craftfleet.Env(**ARGUMENTS), gymnasium.make("CraftFleet/Crafter-v1", length=15)):
      game = getattr(env, "unwrapped", env)
      recorder = craftfleet.Recorder(env, self.folder, save_video=False)
      recorder.reset()
      here = game.snapshot()
      recorder.step(0)
      game.restore(here)
      for _ in range(15):
        *_, info = recorder.step(0)
      self.assertEqual(list(self.folder.iterdir()), [])
    play(recorder, 1)
    self.assertEqual((craftfleet.score(self.folder).episodes, craftfleet.score(self.folder).length), (1, 15))

  def test_without_a_directory_nothing_is_written(self):
    play(craftfleet.Recorder(craftfleet.Env(**ARGUMENTS), None), 1)


class Runs(FolderCase):

  def setUp(self):
    super().setUp()
    self.trained = python_case.trained_run(self.folder / "trained", python_case.SMALL_RUN)

  def test_score_is_that_of_the_programs(self):
    golden = json.loads((SOURCE / "tests/data/agents/score.json").read_text())
    lines = []
    for number, episode in enumerate(golden["episodes"], 1):
      counts = dict(zip(golden["achievement_order"], episode["achievement_counts"]))
      stats = {"length": episode["length"], "reward": round(episode["reward"], 1)}
      lines.append(json.dumps(stats | {f"achievement_{name}": count for name, count in counts.items()}) + "\n")
      (self.folder / "stats.jsonl").write_text("".join(lines) + '{"length": 3')  # a line that is being written
      self.check_score(craftfleet.score(self.folder), episode["after"], number)
    (self.folder / "stats.jsonl.gz").write_bytes(gzip.compress("".join(lines).encode()))
    self.assertEqual(craftfleet.score(self.folder / "stats.jsonl.gz"), craftfleet.score(self.folder / "stats.jsonl"))

  def check_score(self, score, after, number):
    self.assertEqual(score.episodes, number)
    self.assertAlmostEqual(score.score, after["score"], places=9)

  def test_weights_are_those_of_the_newest_checkpoint(self):
    weights = craftfleet.load_weights(self.trained)
    *_, checkpoint = sorted((self.trained / "checkpoints").iterdir())
    for path in (checkpoint, checkpoint / "weights.safetensors"):
      again = craftfleet.load_weights(path)
      self.assertEqual({name: value.tobytes() for name, value in again.items()},
                       {name: value.tobytes() for name, value in weights.items()})
    self.assertEqual({value.dtype for value in weights.values()}, {np.dtype(np.float32)})
    self.assertGreater(sum(value.size for value in weights.values()), 10000)
    self.assertTrue(all(np.isfinite(value).all() for value in weights.values()))

  def test_other_names_beside_checkpoints_are_ignored(self):
    run = self.folder / "run"
    shutil.copytree(self.trained, run)
    for name in ("iter-00000010.bak", "iter-", "iter-99999999-old", "iter-٣", "best"):
      (run / "checkpoints" / name).mkdir()
    self.assertEqual(set(craftfleet.load_weights(run)), set(craftfleet.load_weights(self.trained)))

  def test_what_is_missing_or_damaged_is_named(self):
    self.assert_refused(FileNotFoundError, "stats.jsonl", craftfleet.score, self.folder)
    (self.folder / "stats.jsonl").write_text("")
    self.assert_refused(ValueError, "stats.jsonl: no finished episode", craftfleet.score, self.folder)
    (self.folder / "stats.jsonl").write_text('{"length": 1}\n')
    self.assert_refused(ValueError, 'stats.jsonl:1: no number "reward"', craftfleet.score, self.folder)
    self.assert_refused(FileNotFoundError, "weights.safetensors", craftfleet.load_weights, self.folder)
    (self.folder / "checkpoints").mkdir()
    self.assert_refused(FileNotFoundError, "no checkpoint, want folders like iter-", craftfleet.load_weights, self.folder)
    (self.folder / "checkpoints/iter-00000010.bak").mkdir()
    self.assert_refused(FileNotFoundError, "no checkpoint, want folders like iter-", craftfleet.load_weights, self.folder)
    self.assert_refused(FileNotFoundError, "no curves, want the folder of a run", craftfleet.load_curves, self.folder / "stats.jsonl")
    (self.folder / "x.npz").touch()
    self.assert_refused(ValueError, "x.npz: want a stats.jsonl or the folder with it", craftfleet.score, self.folder / "x.npz")
    whole = next((self.trained / "checkpoints").glob("*/weights.safetensors")).read_bytes()
    events = self.folder / "events.out.tfevents.craftfleet"
    for event in (b"\x80",  # a field that goes on behind its record
                  b"\x2a\x09\x0a\x07\x08\x05\x15\0\0\0\0",  # a tag that is a number
                  b"\x12\x01\x07\x2a\x0a\x0a\x08\x0a\x01a\x15\0\0\0\0"):  # a step that is a text
      events.write_bytes(len(event).to_bytes(8, "little") + bytes(4) + event + bytes(4))
      self.assert_refused(ValueError, "tfevents.craftfleet: damaged", craftfleet.load_curves, self.folder)
    strange = [with_header(tensor(shape)) for shape in (b"[-1]", b"null", b"[2.0]", b"[1]", b"[3]")]
    for content in (b"", b"garbage!" * 9, whole[:200], whole[:-4], with_header(b"[" * 100000), *strange):
      (self.folder / "bad.safetensors").write_bytes(content)
      self.assert_refused(ValueError, "not the weights of a checkpoint", craftfleet.load_weights, self.folder / "bad.safetensors")


if __name__ == "__main__":
  python_case.main()
