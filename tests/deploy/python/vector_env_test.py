"""craftfleet.VectorEnv: the games of Gymnasium's own vector, on threads, in arrays that are allocated once."""

import contextlib
import copy
import ctypes.util
import multiprocessing
import os
import pickle
import shutil
import subprocess
import sys
import tempfile
import threading
import unittest
import warnings

from tests.deploy.python import package
from tests.fakes import python_case
from tests.fakes.python_case import BIN

package.need("craftfleet", "gymnasium")
import craftfleet  # pylint: disable=wrong-import-position
import gymnasium  # pylint: disable=wrong-import-position
import numpy as np  # pylint: disable=wrong-import-position
from gymnasium.utils.env_checker import data_equivalence  # pylint: disable=wrong-import-position

NAME = "CraftFleet/Crafter-v1"
SHORT = {"length": 12, "area": (32, 32)}  # episodes end often


def play(envs, count, seed=0):
  out = []
  for actions in np.random.default_rng(seed).integers(17, size=(count, envs.num_envs)):
    observations, rewards, terminated, truncated, _ = envs.step(actions)
    out.append((observations.tobytes(), rewards.tobytes(), terminated.tobytes(), truncated.tobytes()))
  return out


def started(lanes=5, seed=3, **arguments):
  envs = craftfleet.VectorEnv(lanes, **{**SHORT, **arguments})
  envs.reset(seed=seed)
  return envs


def play_given(envs):
  return play(envs, 20)


class Named(craftfleet.VectorEnv):
  """As a user derives a class, with an argument and an attribute of its own."""

  def __init__(self, name):
    super().__init__(2, **SHORT)
    self.name = name
    self.observation_space = gymnasium.spaces.Box(0, 1, (2, 3, 64, 64), np.float32)


def send_played(writer, envs):
  writer.send(play_given(envs))


class LikeGymnasium(package.PackageCase):

  def compare(self, mode):
    """Every value of every call equals that of Gymnasium's SyncVectorEnv of single environments."""
    envs = [craftfleet.VectorEnv(4, autoreset_mode=mode, semantic=True, threads=2, copy=copied, **SHORT) for copied in (False, True)]
    theirs = gymnasium.make_vec(
        NAME, num_envs=4, vectorization_mode="sync", vector_kwargs={"autoreset_mode": mode, "copy": True}, **SHORT)
    expected = theirs.reset(seed=11)
    for ours in envs:
      self.assertTrue(data_equivalence(tuple(ours.reset(seed=11)), tuple(expected), exact=True))
    for actions in np.random.default_rng(5).integers(17, size=(60, 4)):
      expected = theirs.step(actions)
      for ours in envs:
        found = ours.step(actions)
        self.assertTrue(data_equivalence(tuple(found[:4]), tuple(expected[:4]), exact=True))
        self.compare_infos(found[4], expected[4])
      over = expected[2] | expected[3]
      if mode == "Disabled" and over.any():
        expected = theirs.reset(options={"reset_mask": over})
        for ours in envs:
          self.assertTrue((ours.reset(options={"reset_mask": over})[0] == expected[0]).all())
    for ours in envs:
      self.assertEqual(ours.observation_space, theirs.observation_space)
      self.assertEqual(ours.action_space, theirs.action_space)
      self.assertEqual(ours.metadata["autoreset_mode"], theirs.metadata["autoreset_mode"])

  def compare_infos(self, found, expected):
    """In the lanes that have a value; elsewhere it is undefined."""
    self.assertEqual(found.keys(), expected.keys())
    for name, value in expected.items():
      if name.startswith("_"):
        self.assertEqual(found[name].tolist(), value.tolist(), name)
      elif isinstance(value, dict):
        self.compare_infos(found[name], value)
      else:
        mask = expected[f"_{name}"]
        for lane in np.flatnonzero(mask):
          self.assertTrue(np.array_equal(found[name][lane], value[lane]), name)
        self.assertEqual(found[name].dtype, value.dtype, name)

  def test_next_step(self):
    self.compare("NextStep")

  def test_same_step(self):
    self.compare("SameStep")

  def test_disabled(self):
    self.compare("Disabled")

  def test_make_vec_makes_it(self):
    envs = gymnasium.make_vec("CraftFleet/CrafterNoReward-v1", num_envs=3, env="crafter:numbers=hard-x2", threads=2)
    self.assertIsInstance(envs, craftfleet.VectorEnv)
    envs.reset(seed=1)
    steps = [envs.step(np.full(3, 6)) for _ in range(5)]
    self.assertEqual({reward for step in steps for reward in step[1]}, {0.0})

  def test_make_vec_limits_episodes(self):
    for given, expected in (({"max_episode_steps": 5}, 5), ({"max_episode_steps": 5, "length": 3}, 3),
                            ({"max_episode_steps": 5, "length": None}, 5)):
      envs = gymnasium.make_vec(NAME, num_envs=2, **given)
      envs.reset(seed=1)
      truncated = [envs.step(np.zeros(2, int))[3].tolist() for _ in range(expected)]
      self.assertEqual(truncated, [[False] * 2] * (expected - 1) + [[True] * 2], given)
    self.assert_refused(ValueError, "max_episode_steps 0, want 1..", craftfleet.VectorEnv, 2, max_episode_steps=0)


class Lanes(package.PackageCase):

  def test_games_do_not_depend_on_threads(self):
    expected = play(started(lanes=13), 100)
    for threads in (2, 3, 32):
      self.assertEqual(play(started(lanes=13, threads=threads), 100), expected)

  def test_arrays_are_allocated_once_and_shared_by_dlpack(self):
    envs = started(copy=False)
    observations, infos = envs.reset()
    found, rewards, *_, later = envs.step(np.zeros(5, int))
    self.assertIs(found, observations)
    self.assertIs(later["inventory"]["wood"], infos["inventory"]["wood"])
    shared = np.from_dlpack(observations)
    self.assertEqual(shared.__array_interface__["data"][0], observations.__array_interface__["data"][0])
    self.assertIs(envs.step(np.zeros(5, int))[1], rewards)
    kept = observations.tobytes()
    del envs, found, later, infos
    self.assertEqual(observations.tobytes(), kept)

  def test_who_writes_the_arrays_does_not_change_the_games(self):
    for mode in ("NextStep", "SameStep", "Disabled"):
      plain, written = started(autoreset_mode=mode), started(autoreset_mode=mode, copy=False)
      for step in range(1, 12):
        for array in written.step(np.zeros(5, int))[:4]:
          array[...] = step % 2
        plain.step(np.zeros(5, int))
      self.assertEqual(play(written, 1), play(plain, 1))

  def test_what_calls_return_is_kept_by_the_next_step(self):
    for envs in (started(), started(autoreset_mode="SameStep", length=1), gymnasium.make_vec(NAME, num_envs=5)):
      kept = [envs.reset(seed=1), envs.step(np.full(5, 1)), envs.restore(envs.snapshot())]
      before = copy.deepcopy(kept)
      play(envs, 30)
      self.assertTrue(data_equivalence(kept, before, exact=True))

  def test_seeds_are_numbers_lists_or_random(self):
    listed = started(seed=[7, 8, 9, 10, 11])
    self.assertEqual(play(listed, 20), play(started(seed=7), 20))
    random = [craftfleet.VectorEnv(2).reset()[0].tobytes() for _ in range(2)]
    self.assertNotEqual(*random)
    mixed = started(seed=[1, None, 1, None, 1])
    frames = mixed.step(np.zeros(5, int))[0]
    self.assertTrue((frames[0] == frames[2]).all())

  def test_the_next_reset_goes_on_to_the_next_episode(self):
    envs, single = started(lanes=1, seed=3), craftfleet.Env(seed=3, **SHORT)
    single.reset()
    self.assertEqual(envs.reset()[0].tobytes(), single.reset().tobytes())

  def test_snapshots_fan_out_and_move_between_environments(self):
    envs = started(length=None)
    play(envs, 50)
    snapshots = envs.snapshot()
    envs.restore([snapshots[2]] * 5)
    frames = envs.step(np.full(5, 3))[0]
    single = craftfleet.Env(**{**SHORT, "length": None})
    single.restore(snapshots[2])
    frame = single.step(3)[0]
    for lane in range(5):
      self.assertEqual(frames[lane].tobytes(), frame.tobytes())

  def test_copies_and_pickles_are_clones(self):
    for mode in ("NextStep", "SameStep"):
      envs = started(autoreset_mode=mode, threads=2)
      for _ in range(12):  # in NEXT_STEP all lanes are then about to be reset
        envs.step(np.zeros(5, int))
      clones = [copy.copy(envs), copy.deepcopy(envs), pickle.loads(pickle.dumps(envs))]
      expected = play(envs, 40)
      for clone in clones:
        self.assertEqual(play(clone, 40), expected)
    self.assertEqual(pickle.loads(pickle.dumps(craftfleet.VectorEnv(3))).num_envs, 3)

  def test_copies_have_all_attributes(self):
    envs, named = gymnasium.make_vec(NAME, num_envs=2), Named("mine")
    envs.action_space.seed(4)
    envs.observation_space.seed(4)
    named.close()
    for clone in (copy.deepcopy, lambda original: pickle.loads(pickle.dumps(original))):
      self.assertEqual(clone(envs).spec, envs.spec)
      self.assertEqual(clone(envs).action_space.sample().tolist(), copy.deepcopy(envs.action_space).sample().tolist())
      self.assertTrue(np.array_equal(clone(envs).observation_space.sample(), copy.deepcopy(envs.observation_space).sample()))
      self.assertEqual(clone(named).observation_space, named.observation_space)
      self.assertEqual((clone(named).name, clone(named).closed), ("mine", True))

  def test_copies_draw_with_the_textures_of_a_relative_folder(self):
    with tempfile.TemporaryDirectory() as folder:
      shutil.copytree(python_case.SOURCE / "envserver/textures", f"{folder}/art")
      with contextlib.chdir(folder):
        envs = craftfleet.VectorEnv(2, textures="art")
      observations = envs.reset(seed=0)[0]
      self.assertEqual(copy.copy(envs).reset(seed=0)[0].tobytes(), observations.tobytes())

  def test_masks_of_infos_cannot_be_written(self):
    envs = started()
    infos = envs.step(np.zeros(5, int))[4]
    with self.assertRaises(ValueError):
      infos["_reward"][0] = False
    infos["inventory"]["mine"] = 1
    self.assertNotIn("mine", envs.step(np.zeros(5, int))[4]["inventory"])

  def test_copies_have_the_games_of_the_lanes_that_have_begun(self):
    envs = craftfleet.VectorEnv(3)
    envs.reset(seed=5, options={"reset_mask": np.array([False, True, False])})
    clone = pickle.loads(pickle.dumps(envs))
    self.assert_refused(RuntimeError, "lane 0: no game yet", clone.step, np.zeros(3, int))
    rest = {"reset_mask": np.array([True, False, True])}
    self.assertEqual(clone.reset(seed=5, options=rest)[0].tobytes(), envs.reset(seed=5, options=rest)[0].tobytes())

  def test_after_close_it_says_so(self):
    envs = started()
    envs.close()
    for call in (envs.reset, lambda: envs.step([0] * 5)):
      self.assert_refused(RuntimeError, "this VectorEnv is closed, want a new one", call)

  def test_render_draws_each_lane(self):
    envs = started(render_mode="rgb_array", render_size=90)
    pictures = envs.render()
    self.assertEqual([picture.shape for picture in pictures], [(90, 90, 3)] * 5)
    self.assertIsNone(started().render())

  def test_errors_name_the_lane_and_move_none(self):
    envs = started(autoreset_mode="Disabled")
    before = envs.snapshot()
    new = craftfleet.VectorEnv(2)
    for kind, text, call in (
        (ValueError, "actions[3] 17, want 0..16", lambda: envs.step([0, 0, 0, 17, 0])),
        (ValueError, "actions of shape (4,), want (5,)", lambda: envs.step([0] * 4)),
        (TypeError, "actions of type float64, want integers", lambda: envs.step([0.5] * 5)),
        (RuntimeError, "lane 0: no game yet, want reset() first", lambda: new.step([0, 0])),
        (ValueError, "num_envs 0, want 1..", lambda: craftfleet.VectorEnv(0)),
        (ValueError, "threads 0, want 1..", lambda: craftfleet.VectorEnv(1, threads=0)),
        (ValueError, "render_mode 'human', want None or 'rgb_array'", lambda: craftfleet.VectorEnv(1, render_mode="human")),
        (ValueError, "render_size 4: picture width 4, want 14..2048", lambda: craftfleet.VectorEnv(1, view=(7, 9), render_size=4)),
        (ValueError, "autoreset_mode 'never', want one of", lambda: craftfleet.VectorEnv(1, autoreset_mode="never")),
        (ValueError, "2 seeds, want one for each of 5 lanes", lambda: envs.reset(seed=[1, 2])),
        (ValueError, "reset_mask [1, 0], want a NumPy array", lambda: envs.reset(options={"reset_mask": [1, 0]})),
        (TypeError, "options [1], want a dict", lambda: envs.reset(options=[1])),
        (ValueError, "1 snapshots, want one for each of 5 lanes", lambda: envs.restore([b""])),
        (TypeError, "snapshots of type bytes, want a list with one for each of 5 lanes", lambda: envs.restore(before[0])),
        (ValueError, "lane 0: snapshot: cut, damaged", lambda: envs.restore([b""] * 5)),
        (TypeError, "snapshots[0] of type bytearray, want bytes", lambda: envs.restore([bytearray(before[0])] * 5)),
    ):
      with self.subTest(text):
        self.assert_refused(kind, text, call)
    self.assertEqual(envs.snapshot(), before)
    for _ in range(12):
      envs.step([0] * 5)
    self.assert_refused(RuntimeError, "lane 0: its episode is over, want reset(", envs.step, [0] * 5)


class Limits(package.PackageCase):
  """In a process of its own, with the environment and libraries of a site."""

  def run_with(self, code, **variables):
    return subprocess.run(
        [sys.executable, "-c", f"import craftfleet, numpy as np, os\n{code}"], capture_output=True, text=True, timeout=120,
        check=False, env={**os.environ, "PYTHONPATH": str(package.SITE), **variables})

  def test_a_system_that_starts_no_more_threads_is_an_exception(self):
    library = BIN / "libcraftfleet_few_threads.so"
    if not library.exists():
      self.skipTest(f"no {library}, want: ninja craftfleet_few_threads")
    ended = self.run_with("""
envs = craftfleet.VectorEnv(256, threads=64)
for call in (lambda: envs.reset(seed=1), lambda: envs.reset(seed=1)):
  try:
    call()
  except RuntimeError as error:
    print(error)
few = craftfleet.VectorEnv(256, threads=2)
print(few.reset(seed=1)[0].shape)
""", LD_PRELOAD=str(library), FEW_THREADS="16", OPENBLAS_NUM_THREADS="1")
    self.assertEqual(ended.returncode, 0, ended.stderr)
    self.assertEqual(ended.stdout.count("threads 64: the system starts no more ("), 2, ended.stdout)
    self.assertIn("want fewer, or a higher limit (ulimit -u", ended.stdout)
    self.assertIn("(256, 64, 64, 3)", ended.stdout)

  def test_a_daemon_thread_that_plays_does_not_abort_the_end_of_the_program(self):
    for threads in (1, 2):
      ended = self.run_with(f"""
import sys, threading
envs = craftfleet.VectorEnv(32, threads={threads})
envs.reset(seed=1)
begun = threading.Event()
def play():
  while True:
    envs.step(np.zeros(32, int))
    begun.set()
threading.Thread(target=play, daemon=True).start()
begun.wait()
sys.exit(3)
""", OPENBLAS_NUM_THREADS="1")
      self.assertEqual((ended.returncode, ended.stderr), (3, ""))

  @unittest.skipUnless(len(os.sched_getaffinity(0)) > 1, "one CPU, want two")
  def test_openmp_that_binds_threads_leaves_those_of_the_games_all_cpus(self):
    found = ctypes.util.find_library("gomp")
    if found is None:
      self.skipTest("no libgomp")
    two = " ".join(map(str, sorted(os.sched_getaffinity(0))[:2]))
    for variables in ({"OMP_PROC_BIND": "true"}, {"GOMP_CPU_AFFINITY": two}):
      ended = self.run_with(f"""
import ctypes
ctypes.CDLL({found!r}, mode=ctypes.RTLD_GLOBAL)  # as PyTorch does
print(len(os.sched_getaffinity(0)))
envs = craftfleet.VectorEnv(8, threads=4)
envs.reset(seed=1)
for _ in range(300):  # until all threads have begun
  envs.step(np.zeros(8, int))
print(sorted(len(os.sched_getaffinity(int(task))) for task in os.listdir("/proc/self/task"))[-3:])
""", **variables, OPENBLAS_NUM_THREADS="1")
      cpus = len(os.sched_getaffinity(0)) if "OMP_PROC_BIND" in variables else 2
      self.assertEqual(ended.stdout, f"1\n{[cpus] * 3}\n", ended.stderr)


class Around(package.PackageCase):

  def test_forked_and_spawned_processes_continue_with_their_copy(self):
    envs = started(threads=3)
    play(envs, 5)
    expected = play(copy.copy(envs), 20)
    warnings.simplefilter("ignore", DeprecationWarning)  # newer Pythons warn of a fork beside any thread
    with multiprocessing.get_context("spawn").Pool(1) as pool:
      self.assertEqual(pool.apply(play_given, (envs,)), expected)
    for _ in range(2):
      reader, writer = multiprocessing.Pipe(duplex=False)
      child = multiprocessing.get_context("fork").Process(target=send_played, args=(writer, envs))
      child.start()
      self.assertTrue(reader.poll(60), "the fork hangs")
      self.assertEqual(reader.recv(), expected)
      child.join(60)
      self.assertEqual(child.exitcode, 0)
    self.assertEqual(play(envs, 20), expected)

  def test_a_step_lets_other_threads_run_and_refuses_a_second_one_beside_it(self):
    envs = craftfleet.VectorEnv(64)
    envs.reset(seed=0)
    refused, stop = [], threading.Event()

    def poke():
      while not stop.is_set():
        try:
          envs.step(np.zeros(64, int))
        except RuntimeError as error:
          refused.append(str(error))

    other = threading.Thread(target=poke)
    other.start()
    try:
      while not refused:
        try:
          envs.step(np.zeros(64, int))
        except RuntimeError as error:
          refused.append(str(error))
    finally:
      stop.set()
      other.join()
    self.assertEqual(set(refused), {"another thread is in a call of this VectorEnv, want one at a time"})


if __name__ == "__main__":
  python_case.main()
