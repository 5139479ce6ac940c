#!/usr/bin/env python3
"""Stable-Baselines3's PPO on craftfleet.VectorEnv. Needs: pip install stable-baselines3

Usage: sb3_ppo.py [--steps=N] [--lanes=N] [--out=FILE]
  --steps=N   steps of all lanes together, default 200000
  --lanes=N   games played side by side, default 16
  --out=FILE  where the model goes, default crafter-ppo.zip
"""

import argparse

import craftfleet
import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import VecEnv, VecMonitor


class Games(VecEnv):
  """A craftfleet.VectorEnv with the interface that Stable-Baselines3 has for many games."""

  def __init__(self, lanes, **arguments):
    self.envs = craftfleet.VectorEnv(lanes, autoreset_mode="SameStep", **arguments)
    self.render_mode = self.envs.render_mode
    super().__init__(lanes, self.envs.single_observation_space, self.envs.single_action_space)

  def reset(self):
    seeded = any(seed is not None for seed in self._seeds)
    observations, _ = self.envs.reset(seed=self._seeds if seeded else None)
    self._reset_seeds()
    return observations

  def step_async(self, actions):
    self._actions = actions

  def step_wait(self):
    observations, rewards, terminated, truncated, found = self.envs.step(self._actions)
    infos = [{"TimeLimit.truncated": bool(cut)} for cut in truncated]
    for lane in np.flatnonzero(terminated | truncated):
      infos[lane]["terminal_observation"] = found["final_obs"][lane]
    return observations, rewards.astype(np.float32), terminated | truncated, infos

  def get_images(self):
    return self.envs.render()

  def close(self):
    self.envs.close()

  def get_attr(self, attr_name, indices=None):
    return [getattr(self, attr_name)] * len(self._get_indices(indices))

  def set_attr(self, attr_name, value, indices=None):
    raise NotImplementedError(f"set_attr({attr_name!r}): pass arguments to Games(...)")

  def env_method(self, method_name, *method_args, indices=None, **method_kwargs):
    raise NotImplementedError(f"env_method({method_name!r}): call methods of Games(...).envs")

  def env_is_wrapped(self, wrapper_class, indices=None):
    return [False] * len(self._get_indices(indices))


def main():
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("--steps", type=int, default=200_000)
  parser.add_argument("--lanes", type=int, default=16)
  parser.add_argument("--out", default="crafter-ppo.zip")
  arguments = parser.parse_args()
  games = VecMonitor(Games(arguments.lanes))  # counts rewards and lengths of episodes
  model = PPO("CnnPolicy", games, n_steps=128, batch_size=256, n_epochs=4, gamma=0.97, ent_coef=0.01, seed=1, verbose=1)
  model.learn(arguments.steps)
  model.save(arguments.out)
  mean, deviation = evaluate_policy(model, VecMonitor(Games(arguments.lanes)), n_eval_episodes=arguments.lanes, deterministic=False)
  print(f"{arguments.out}: reward {mean:.1f} +- {deviation:.1f} in {arguments.lanes} episodes")


if __name__ == "__main__":
  main()
