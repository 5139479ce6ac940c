"""craftfleet.Env beside the original, its errors, copies and snapshots, and what processes and threads do around it."""

import concurrent.futures
import copy
import multiprocessing
import os
import pathlib
import pickle
import shutil
import tempfile
import threading
import typing
import warnings

from tests.deploy.python import package
from tests.fakes import python_case
from tests.fakes.python_case import SOURCE

package.need("craftfleet", "numpy")
import craftfleet  # pylint: disable=wrong-import-position
import numpy as np  # pylint: disable=wrong-import-position


def actions(count, seed=0):
  return np.random.default_rng(seed).integers(len(craftfleet.ACTIONS), size=count).tolist()


def play(env, count, seed=0):
  """Observations, rewards and ends of `count` random actions, as bytes."""
  out = []
  for action in actions(count, seed):
    observation, reward, done, info = env.step(action)
    out.append((observation.tobytes(), reward, done, info["semantic"].tobytes()))
    if done:
      out.append(env.reset().tobytes())
  return out


def started(**arguments):
  env = craftfleet.Env(**{"seed": 5, **arguments})
  env.reset()
  return env


def play_pickled(pickled):
  return play(pickle.loads(pickled), 30)


def shape_of(value):
  """Types all the way down, with the shapes of arrays."""
  if isinstance(value, dict):
    return {key: shape_of(item) for key, item in value.items()}
  if isinstance(value, np.ndarray):
    return value.dtype, value.shape
  return type(value)


class Beside(package.PackageCase):
  """The original, crafter 1.8.3."""

  def setUp(self):
    super().setUp()
    try:
      import crafter  # pylint: disable=import-outside-toplevel
    except ImportError as error:
      self.skipTest(f"{error}, want: deploy/install-deps.sh --tests")
    self.crafter = crafter

  def test_observations_and_infos_have_the_same_keys_shapes_and_types(self):
    for arguments in ({}, {"size": 96, "view": 7, "area": (32, 48), "length": 3}, {"size": (72, 72), "reward": False}):
      ours, theirs = craftfleet.Env(seed=1, **arguments), self.crafter.Env(seed=1, **arguments)
      self.assertEqual(shape_of(ours.reset()), shape_of(theirs.reset()))
      for action in (0, np.int64(3), 5):
        mine, original = ours.step(action), theirs.step(action)
        self.assertEqual([shape_of(item) for item in mine], [shape_of(item) for item in original])
        self.assertEqual([list(mine[3]), *map(list, (mine[3]["inventory"], mine[3]["achievements"]))],
                         [list(original[3]), *map(list, (original[3]["inventory"], original[3]["achievements"]))])
        self.assertEqual(mine[2], original[2])
      self.assertEqual(shape_of(ours.render((128, 96))), shape_of(theirs.render((128, 96))))
      self.assertEqual(ours.observation_space.shape, theirs.observation_space.shape)
      self.assertEqual(ours.action_space.n, theirs.action_space.n)
      self.assertEqual(list(ours.action_names), list(theirs.action_names))
      self.assertEqual((ours.metadata, ours.reward_range), (theirs.metadata, theirs.reward_range))

  def test_its_textures_are_found(self):
    seen = [started(textures=textures).picture().tobytes() for textures in ("crafter", None)]
    folder = f"{self.crafter.__path__[0]}/assets"
    self.assertEqual(started(textures=folder).picture().tobytes(), seen[0])
    self.assertNotEqual(seen[0], seen[1])


class Env(package.PackageCase):

  def test_a_seed_gives_the_same_episodes_and_another_one_others(self):
    self.assertEqual(play(started(), 300), play(started(), 300))
    self.assertNotEqual(play(started(), 300), play(started(seed=6), 300))

  def test_without_a_seed_it_takes_one_from_numpy(self):
    first = []
    for _ in range(2):
      np.random.seed(9)
      first.append(craftfleet.Env().reset().tobytes())
    self.assertEqual(first[0], first[1])
    self.assertNotEqual(craftfleet.Env().reset().tobytes(), first[0])

  def test_without_reward_only_the_info_has_it(self):
    rewards = [(env.step(6)[1], env.step(6)[3]["reward"]) for env in [started(reward=False)] for _ in range(100)]
    self.assertEqual({reward for reward, _ in rewards}, {0.0})
    self.assertNotEqual({reward for _, reward in rewards}, {0.0})

  def test_textures_are_those_of_the_folder_where_it_was_made(self):
    self.addCleanup(os.chdir, os.getcwd())
    os.chdir(SOURCE / "envserver")
    pickled = pickle.dumps(started(textures="textures"))
    os.chdir("/")
    self.assertEqual(pickle.loads(pickled).picture().tobytes(), started().picture().tobytes())
    self.assert_refused(FileNotFoundError, "/textures", craftfleet.Env, textures="textures")

  def test_textures_that_were_edited_are_read_anew(self):
    temp = tempfile.TemporaryDirectory(prefix="craftfleet-")
    self.addCleanup(temp.cleanup)
    folder = pathlib.Path(temp.name) / "textures"
    shutil.copytree(SOURCE / "envserver/textures", folder)
    env = started(textures=folder)
    before = env.picture().tobytes()
    shutil.copy(folder / "lava.png", folder / "grass.png")
    self.assertNotEqual(started(textures=folder).picture().tobytes(), before)
    self.assertEqual(copy.deepcopy(env).picture().tobytes(), before)

  def test_the_actions_that_a_space_samples_have_the_type_that_step_wants(self):
    for env in (craftfleet.Env(), craftfleet.GymnasiumEnv()):
      self.assertIsInstance(env.action_space.sample(), typing.get_type_hints(type(env).step)["action"])

  def test_length_ends_an_episode_and_none_means_no_limit(self):
    ends = [started(length=length).step(0)[2] for length in (1, 2, None, 0)]
    self.assertEqual(ends, [True, False, False, False])

  def test_variants_change_the_world_and_the_picture(self):
    names = ("crafter", "crafter:numbers=easy-x4", "crafter:appearance=0/33/33/34", "crafter:inventory=off")
    self.assertEqual(len({started(env=name).picture().tobytes() for name in names}), len(names))

  def night(self):
    """An environment at night, when pictures have noise."""
    env = started(seed=2, length=None)
    for _ in range(250):
      env.step(0)
    return env

  def test_picture_leaves_the_game_alone_and_render_takes_noise_as_the_original_does(self):
    env = self.night()
    observation = env.step(0)[0]
    before = env.snapshot()
    self.assertEqual(env.picture().tobytes(), observation.tobytes())
    self.assertEqual(env.picture((90, 180)).shape, (180, 90, 3))
    self.assertEqual(env.snapshot(), before)
    self.assertNotEqual(env.render().tobytes(), observation.tobytes())
    self.assertNotEqual(env.snapshot(), before)

  def test_errors_name_the_argument_the_value_and_what_was_expected(self):
    env = started()
    for kind, text, call in (
        (ValueError, "action 17, want 0..16", lambda: env.step(17)),
        (ValueError, "action -1, want 0..16", lambda: env.step(-1)),
        (TypeError, "action 1.5, want an integer of 0..16", lambda: env.step(1.5)),
        (TypeError, "action 'noop', want an integer", lambda: env.step("noop")),
        (RuntimeError, "step(): no game yet, want reset() first", lambda: craftfleet.Env().step(0)),
        (RuntimeError, "snapshot(): no game yet", lambda: craftfleet.Env().snapshot()),
        (RuntimeError, "render(): no game yet", lambda: craftfleet.Env().render()),
        (RuntimeError, "picture(): no game yet", lambda: craftfleet.Env().picture()),
        (ValueError, "area=(2, 64)", lambda: craftfleet.Env(area=(2, 64))),
        (ValueError, "width 2, want 4..250", lambda: craftfleet.Env(area=(2, 64))),
        (ValueError, "view (9, 9, 9), want one or two integers", lambda: craftfleet.Env(view=(9, 9, 9))),
        (ValueError, "view_height 1, want 3..63", lambda: craftfleet.Env(view=(9, 1))),
        (ValueError, "size[0] -5, want 1..", lambda: craftfleet.Env(size=-5)),
        (ValueError, "picture width 10, want 18..2048", lambda: craftfleet.Env(size=(10, 64))),
        (ValueError, "picture height 3000, want 18..2048", lambda: env.render((64, 3000))),
        (TypeError, "size[0] 'a', want an integer", lambda: craftfleet.Env(size=("a", "b"))),
        (ValueError, "length -1, want 0..1000000000", lambda: craftfleet.Env(length=-1)),
        (ValueError, f"seed {2**63}, want ", lambda: craftfleet.Env(seed=2**63)),
        (TypeError, "seed 'x', want an integer", lambda: craftfleet.Env(seed="x")),
        (ValueError, 'numbers "many", want one of default, easy-x2', lambda: craftfleet.Env(env="crafter:numbers=many")),
        (TypeError, "env 3, want the name of an environment", lambda: craftfleet.Env(env=3)),
        (ValueError, "env 'crafter\\udcff', want a name in UTF-8", lambda: craftfleet.Env(env="crafter\udcff")),
        (ValueError, "env 'crafter\\x00', want a name in UTF-8 without NUL", lambda: craftfleet.Env(env="crafter\0")),
        (ValueError, "/art\\udcff', want a name in UTF-8", lambda: craftfleet.Env(textures=os.fsdecode(b"/art\xff"))),
        (ValueError, "/art\\x00', want a name in UTF-8 without NUL", lambda: craftfleet.Env(textures="/art\0")),
        (FileNotFoundError, "/nowhere", lambda: craftfleet.Env(textures="/nowhere")),
        (NotADirectoryError, f"textures '{__file__}', want a folder", lambda: craftfleet.Env(textures=__file__)),
        (TypeError, "textures 3, want None, 'crafter' or a folder", lambda: craftfleet.Env(textures=3)),
        (TypeError, "snapshot of type int, want bytes", lambda: env.restore(3)),
        (ValueError, "snapshot: cut, damaged", lambda: env.restore(b"")),
    ):
      with self.subTest(text):
        self.assert_refused(kind, text, call)
    env.step(np.array(3))
    env.close()


class Clones(package.PackageCase):

  def clones(self, env):
    other = craftfleet.Env(seed=77)
    other.restore(env.snapshot())
    return [other, copy.copy(env), copy.deepcopy(env), pickle.loads(pickle.dumps(env))]

  def test_copies_continue_as_the_game_itself_even_at_night_after_render(self):
    env = started(seed=2)
    play(env, 230)
    env.render()
    clones = self.clones(env)
    expected = play(env, 400, seed=1)
    for clone in clones:
      self.assertEqual(play(clone, 400, seed=1), expected)

  def test_pickles_have_little_beside_the_snapshot(self):
    for env in (started(), craftfleet.GymnasiumEnv()):
      env.reset()
      pickled = pickle.dumps(env)
      self.assertLess(len(pickled), len(env.snapshot()) + 2000)
      self.assertEqual(pickle.loads(pickled).observation_space, env.observation_space)

  def test_copies_do_not_share_the_game(self):
    env = started()
    before = env.snapshot()
    play(copy.copy(env), 10)
    self.assertEqual(env.snapshot(), before)

  def test_a_game_that_has_not_begun_is_copied_too(self):
    env = craftfleet.Env(seed=4)
    self.assertEqual(copy.copy(env).reset().tobytes(), env.reset().tobytes())

  def test_restore_goes_back_and_returns_the_observation(self):
    env = started()
    play(env, 50)
    observation, snapshot = env.picture(), env.snapshot()
    future = play(env, 100, seed=3)
    self.assertEqual(env.restore(snapshot).tobytes(), observation.tobytes())
    self.assertEqual(play(env, 100, seed=3), future)

  def test_worlds_of_any_size_are_restored(self):
    for area in ((4, 4), (250, 250)):
      env = started(area=area)
      clone = pickle.loads(pickle.dumps(env))
      self.assertEqual(play(clone, 20), play(env, 20))

  def test_damaged_and_foreign_snapshots_are_refused_and_change_nothing(self):
    env = started()
    snapshot = env.snapshot()
    for at in range(0, len(snapshot), 97):
      damaged = snapshot[:at] + bytes([snapshot[at] ^ 1]) + snapshot[at + 1:]
      for bad in (damaged, snapshot[:at]):
        with self.assertRaises(ValueError):
          env.restore(bad)
    for other in (started(area=(32, 32)), started(env="crafter:numbers=mix"), started(length=5)):
      self.assert_refused(ValueError, "other options", env.restore, other.snapshot())
    self.assertEqual(env.snapshot(), snapshot)


class Around(package.PackageCase):
  """Processes and threads."""

  def test_forked_and_spawned_processes_play_the_same_game(self):
    env = started()
    pickled = pickle.dumps(env)
    expected = play(env, 30)
    warnings.simplefilter("ignore", DeprecationWarning)  # newer Pythons warn of a fork beside any thread
    for method in ("fork", "spawn"):
      with multiprocessing.get_context(method).Pool(1) as pool:
        self.assertEqual(pool.apply(play_pickled, (pickled,)), expected)

  def test_threads_with_games_of_their_own_do_not_disturb_each_other(self):
    expected = [play(started(seed=seed), 100) for seed in range(4)]
    with concurrent.futures.ThreadPoolExecutor(4) as threads:
      self.assertEqual(list(threads.map(lambda seed: play(started(seed=seed), 100), range(4))), expected)

  def test_threads_that_share_a_game_do_it_no_harm(self):
    env = started(length=None)
    threads = [threading.Thread(target=play, args=(env, 200, seed)) for seed in range(3)]
    for thread in threads:
      thread.start()
    for thread in threads:
      thread.join()
    self.assertEqual(started(length=None).restore(env.snapshot()).tobytes(), env.picture().tobytes())


if __name__ == "__main__":
  python_case.main()
