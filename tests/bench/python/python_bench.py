#!/usr/bin/env python3
"""How many steps a second the Python package plays on one core, beside the original.

Usage: python_bench.py [--seconds=S] [--rounds=N]
  --seconds=S  CPU time of each measurement, default 3
  --rounds=N   measurements of each, in turn, default 5

Needs the packages craftfleet, and crafter 1.8.3. All play random actions with the original's textures, resets included. Prints the
steps per second of CPU time in each round, and their ratios to the original in the same round: median, lowest and highest.
"""

import argparse
import platform
import statistics
import time

import crafter
import craftfleet
import numpy as np

LANES = 64
ACTIONS = np.random.default_rng(0).integers(17, size=(1000, LANES))


def single(env):
  """Plays the interface of crafter.Env; yields after each step."""
  env.reset()
  while True:
    for action in ACTIONS[:, 0].tolist():
      if env.step(action)[2]:
        env.reset()
      yield 1


def vector():
  envs = craftfleet.VectorEnv(LANES, textures="crafter")
  envs.reset(seed=0)
  while True:
    for actions in ACTIONS:
      envs.step(actions)
      yield LANES


def rate(steps, seconds):
  """Steps per second of CPU time."""
  begin = time.process_time()
  played = 0
  while (passed := time.process_time() - begin) < seconds:
    played += next(steps)
  return played / passed


def cpu():
  with open("/proc/cpuinfo", encoding="utf-8") as lines:
    return next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), platform.machine())


def main():
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("--seconds", type=float, default=3)
  parser.add_argument("--rounds", type=int, default=5)
  arguments = parser.parse_args()
  games = {
      "crafter.Env": single(crafter.Env(seed=0)),
      "craftfleet.Env": single(craftfleet.Env(seed=0, textures="crafter")),
      f"craftfleet.VectorEnv({LANES})": vector(),
  }
  print(f"{cpu()}, Python {platform.python_version()}, NumPy {np.__version__}")
  rates = {name: [] for name in games}
  for number in range(arguments.rounds):
    for name, steps in games.items():
      rates[name].append(rate(steps, arguments.seconds))
    print(f"round {number + 1}: " + ", ".join(f"{name} {found[-1]:,.0f} steps/s" for name, found in rates.items()), flush=True)
  original = rates.pop("crafter.Env")
  for name, found in rates.items():
    ratios = [ours / theirs for ours, theirs in zip(found, original)]
    print(f"{name}: {statistics.median(ratios):.0f} times the original ({min(ratios):.0f} to {max(ratios):.0f})")


if __name__ == "__main__":
  main()
