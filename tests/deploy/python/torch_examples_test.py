"""The examples of the Python package that train: the adapter to Stable-Baselines3 is exact, and the loop in PyTorch learns."""

import re
import sys

from tests.deploy.python import package
from tests.fakes import python_case
from tests.fakes.python_case import SOURCE

package.need("craftfleet", "numpy", torch=("torch", "stable_baselines3"))
sys.path.insert(0, str(SOURCE / "deploy/python/examples"))
import craftfleet  # pylint: disable=wrong-import-position
import gymnasium  # pylint: disable=wrong-import-position
import numpy as np  # pylint: disable=wrong-import-position
import sb3_ppo  # pylint: disable=wrong-import-position
import torch  # pylint: disable=wrong-import-position
import torch_loop  # pylint: disable=wrong-import-position
from stable_baselines3 import PPO  # pylint: disable=wrong-import-position
from stable_baselines3.common.vec_env import DummyVecEnv  # pylint: disable=wrong-import-position

torch.set_num_threads(1)  # many threads on busy cores wait for each other
SHORT = {"area": (32, 32), "length": 12}


class NoopGames(craftfleet.VectorEnv):
  """The reward is 1 for doing nothing, whatever the game says."""

  def step(self, actions):
    observations, _, *rest = super().step(actions)
    return observations, (np.asarray(actions) == 0).astype(float), *rest


class StableBaselines3(python_case.FolderCase, package.PackageCase):

  def test_the_adapter_is_exactly_the_vector_that_stable_baselines3_makes_of_single_environments(self):
    ours = sb3_ppo.Games(4, **SHORT)
    theirs = DummyVecEnv([lambda: gymnasium.make("CraftFleet/Crafter-v1", **SHORT)] * 4)
    for vector in (ours, theirs):
      vector.seed(7)
    self.assertTrue(np.array_equal(ours.reset(), theirs.reset()))
    before = None
    ended = 0
    for actions in np.random.default_rng(1).integers(17, size=(40, 4)):
      (found, *found_ends, infos), (expected, *ends, expected_infos) = ours.step(actions), theirs.step(actions)
      self.assertTrue(np.array_equal(found, expected))
      self.assertTrue(np.array_equal(found_ends, ends))
      for info, other in zip(infos, expected_infos):
        self.assertEqual(info["TimeLimit.truncated"], other["TimeLimit.truncated"])
        self.assertEqual("terminal_observation" in info, "terminal_observation" in other)
        if "terminal_observation" in info:
          self.assertTrue(np.array_equal(info["terminal_observation"], other["terminal_observation"]))
          ended += 1
      self.assertFalse(before is not None and np.shares_memory(found, before))
      before = found
    self.assertGreater(ended, 8)

  def test_ppo_keeps_the_picture_that_each_action_was_chosen_for(self):
    model = PPO("CnnPolicy", sb3_ppo.Games(2, **SHORT), n_steps=16, batch_size=16, n_epochs=1, seed=3)
    model.learn(32)
    envs = craftfleet.VectorEnv(2, autoreset_mode="SameStep", **SHORT)
    frames, _ = envs.reset(seed=3)
    kept = model.rollout_buffer.observations.reshape(2, 16, 3, 64, 64).transpose(1, 0, 3, 4, 2)
    for observations, actions in zip(kept, model.rollout_buffer.actions.reshape(2, 16).T.astype(int)):
      self.assertTrue(np.array_equal(observations, frames))
      frames, *_ = envs.step(actions)

  def test_it_trains_saves_and_evaluates(self):
    ended = package.run_example("sb3_ppo.py", "--steps=1024", "--lanes=8", "--out=model.zip", cwd=self.folder)
    self.assertEqual(ended.returncode, 0, ended.stderr)
    self.assertRegex(ended.stdout, r"total_timesteps +\| 1024")
    self.assertRegex(ended.stdout.splitlines()[-1], r"^model.zip: reward -?[\d.]+ \+- [\d.]+ in 8 episodes$")
    action, _ = PPO.load(self.folder / "model.zip").predict(craftfleet.Env(seed=1).reset())
    self.assertIn(int(action), range(17))


class PlainPyTorch(python_case.FolderCase, package.PackageCase):

  def test_it_learns_what_is_rewarded(self):
    torch.manual_seed(1)
    games = NoopGames(8, autoreset_mode="SameStep", copy=False)
    rewards = [reward for _, reward in torch_loop.train(games, torch_loop.new_network(), 8000)]
    self.assertLess(rewards[0], 0.3)
    self.assertGreater(np.mean(rewards[-5:]), 0.8)

  def test_it_trains(self):
    ended = package.run_example("torch_loop.py", "--steps=5120", cwd=self.folder)
    self.assertEqual(ended.returncode, 0, ended.stderr)
    self.assertEqual(len(re.findall(r"^5120 steps, reward of 100 steps: -?\d+\.\d\d$", ended.stdout, re.MULTILINE)), 1)


if __name__ == "__main__":
  python_case.main()
