"""The Gymnasium environments of the Python package; checkers of Gymnasium and Stable-Baselines3 pass without a warning."""

import copy
import importlib.util
import os
import pathlib
import pickle
import subprocess
import sys
import tempfile
import textwrap
import unittest

from tests.deploy.python import package
from tests.fakes import python_case
from tests.fakes.python_case import SOURCE

package.need("craftfleet", "gymnasium")
import craftfleet  # pylint: disable=wrong-import-position
import gymnasium  # pylint: disable=wrong-import-position
import numpy as np  # pylint: disable=wrong-import-position
from gymnasium.utils.env_checker import check_env  # pylint: disable=wrong-import-position

NAMES = ("CraftFleet/Crafter-v1", "CraftFleet/CrafterNoReward-v1")


def play(env, count, seed=0):
  """Observations, rewards and ends of random actions, as bytes."""
  out = []
  for action in np.random.default_rng(seed).integers(17, size=count):
    observation, reward, terminated, truncated, _ = env.step(action)
    out.append((observation.tobytes(), reward, terminated, truncated))
    if terminated or truncated:
      out.append(env.reset()[0].tobytes())
  return out


class Rows(craftfleet.GymnasiumEnv):
  """As a user derives a class, with observations of its own."""

  def __init__(self):
    super().__init__()
    self.observation_space = gymnasium.spaces.Box(0, 255, (64,), np.float32)

  def reset(self, **options):
    observation, info = super().reset(**options)
    return observation.mean((1, 2), np.float32), info


class Checkers(package.PackageCase):

  def test_gymnasiums_checker_passes_without_a_warning(self):
    for name in NAMES:
      for arguments in ({}, {"env": "crafter:numbers=easy-x2,inventory=off", "size": (96, 80), "view": (7, 9), "render_size": 270}):
        check_env(gymnasium.make(name, **arguments).unwrapped)

  @unittest.skipUnless(
      importlib.util.find_spec("stable_baselines3"), "want: deploy/install-deps.sh --tests=torch")
  def test_the_checker_of_stable_baselines3_passes_without_a_warning(self):
    from stable_baselines3.common.env_checker import check_env as check  # pylint: disable=import-outside-toplevel
    for name in NAMES:
      check(gymnasium.make(name))


class Environment(package.PackageCase):

  def test_it_plays_the_games_of_env(self):
    env, plain = gymnasium.make(NAMES[0]), craftfleet.Env(seed=8)
    self.assertEqual(env.unwrapped.action_names, plain.action_names)
    observation, info = env.reset(seed=8)
    self.assertEqual(observation.tobytes(), plain.reset().tobytes())
    self.assertEqual((info["reward"], info["discount"], info["inventory"]["health"]), (0.0, 1.0, 9))
    for action in np.random.default_rng(1).integers(17, size=400):
      observation, reward, terminated, truncated, info = env.step(action)
      expected = plain.step(action)
      self.assertEqual((observation.tobytes(), reward, terminated or truncated), (expected[0].tobytes(), *expected[1:3]))
      self.assertEqual(info["achievements"], expected[3]["achievements"])
      if terminated or truncated:
        self.assertEqual(env.reset()[0].tobytes(), plain.reset().tobytes())

  def test_a_death_terminates_and_the_length_truncates(self):
    env = gymnasium.make(NAMES[0], length=20, env="crafter:numbers=sssff")
    seen = set()
    for seed in range(40):
      env.reset(seed=seed)
      for _ in range(20):
        _, _, terminated, truncated, info = env.step(0)
        if terminated or truncated:
          break
      self.assertFalse(terminated and truncated)
      self.assertEqual(info["discount"], 0.0 if terminated else 1.0)
      seen.add((terminated, truncated))
    self.assertIn((False, True), seen)
    env = gymnasium.make(NAMES[0], area=(20, 20), env="crafter:numbers=sssff", length=None)
    env.reset(seed=1)
    steps = 0
    while not (terminated := env.step(6)[2]):  # asleep among many zombies
      steps += 1
      self.assertLess(steps, 5000)

  def test_no_reward_has_rewards_in_the_info_only(self):
    env = gymnasium.make(NAMES[1])
    env.reset(seed=0)
    steps = [env.step(6) for _ in range(100)]
    self.assertEqual({step[1] for step in steps}, {0.0})
    self.assertNotEqual({step[4]["reward"] for step in steps}, {0.0})

  def test_rendering_does_not_change_the_game(self):
    env = gymnasium.make(NAMES[0], render_mode="rgb_array", render_size=(180, 90), length=None)
    env.reset(seed=2)
    for _ in range(240):  # into the night
      env.step(0)
    before = env.unwrapped.snapshot()
    self.assertEqual(env.render().shape, (90, 180, 3))
    self.assertEqual(env.unwrapped.snapshot(), before)

  def test_clones_continue_alike(self):
    env = gymnasium.make(NAMES[0])
    env.reset(seed=3)
    play(env, 100)
    clones = [copy.deepcopy(env), pickle.loads(pickle.dumps(env)), copy.copy(env.unwrapped)]
    other = gymnasium.make(NAMES[0])
    other.reset(seed=99)
    other.unwrapped.restore(env.unwrapped.snapshot())
    expected = play(env, 300, seed=1)
    for clone in (*clones, other):
      self.assertEqual(play(clone, 300, seed=1), expected)

  def test_clones_have_the_space_of_a_subclass_and_the_seeds_of_spaces(self):
    rows, seeded = Rows(), craftfleet.GymnasiumEnv()
    seeded.observation_space.seed(4)
    for clone in (copy.copy, copy.deepcopy, lambda original: pickle.loads(pickle.dumps(original))):
      again = clone(clone(rows))
      self.assertEqual(again.observation_space, rows.observation_space)
      self.assertIn(again.reset(seed=0)[0], again.observation_space)
      self.assertTrue(np.array_equal(clone(seeded).observation_space.sample(), copy.deepcopy(seeded.observation_space).sample()))

  def test_errors_are_clear(self):
    env = gymnasium.make(NAMES[0]).unwrapped
    self.assert_refused(ValueError, "seed -1, want 0..", env.reset, seed=-1)
    self.assert_refused(TypeError, "seed 'a', want an integer", env.reset, seed="a")
    self.assert_refused(ValueError, "render_mode 'human', want None or 'rgb_array'", craftfleet.GymnasiumEnv, render_mode="human")
    self.assert_refused(ValueError, "render_size[0] 0, want 1..", craftfleet.GymnasiumEnv, render_size=(0, 5))
    self.assert_refused(ValueError, "render_size (64, 5): picture height 5, want 18..2048 pixels", craftfleet.GymnasiumEnv,
                        render_size=(64, 5))
    self.assert_refused(ValueError, 'unknown game "minecraft", want "crafter"', craftfleet.GymnasiumEnv, env="minecraft")

  def test_spawned_workers_find_the_environment_by_the_id_with_the_package(self):
    """As a user's script would do it; a worker that is spawned has imported nothing."""
    script = self.script("""
        import functools, gymnasium
        if __name__ == "__main__":
          make = functools.partial(gymnasium.make, "craftfleet:CraftFleet/Crafter-v1")
          envs = gymnasium.vector.AsyncVectorEnv([make] * 2, context="spawn")
          print(envs.reset(seed=4)[0].shape)
          envs.close()
        """)
    self.assertEqual(script.stdout, "(2, 64, 64, 3)\n", script.stderr)

  def test_spawned_workers_of_make_vec_need_no_package(self):
    script = self.script("""
        import craftfleet, gymnasium
        if __name__ == "__main__":
          envs = gymnasium.make_vec("CraftFleet/Crafter-v1", 2, vectorization_mode="async", vector_kwargs={"context": "spawn"})
          print(envs.reset(seed=4)[0].shape)
          envs.close()
        """)
    self.assertEqual(script.stdout, "(2, 64, 64, 3)\n", script.stderr)

  def script(self, code):
    with tempfile.TemporaryDirectory(prefix="craftfleet-") as folder:
      path = pathlib.Path(folder) / "script.py"
      path.write_text(textwrap.dedent(code))
      return subprocess.run([sys.executable, path], capture_output=True, text=True, timeout=120, check=False, cwd=folder,
                            env={**os.environ, "PYTHONPATH": str(package.SITE)})

  def test_in_the_folder_of_its_source_the_import_says_what_to_do(self):
    ended = subprocess.run(
        [sys.executable, "-c", "import craftfleet"], capture_output=True, text=True, timeout=120, check=False,
        cwd=SOURCE / "deploy/python", env={**os.environ, "PYTHONPATH": str(package.SITE)})
    self.assertEqual(ended.returncode, 1)
    self.assertIn("start it in another folder", ended.stderr)
    self.assertIn("pip install ./deploy/python", ended.stderr)


if __name__ == "__main__":
  python_case.main()
