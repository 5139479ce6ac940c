#!/usr/bin/env python3
"""Plans with snapshots: a beam search for the actions that collect a stone in a given world.

Usage: beam_search.py [--seed=N] [--beam=N] [--depth=N] [--record=FOLDER]
  --seed=N         the world, default 1
  --beam=N         moments of the game that are kept after each step, default 24
  --depth=N        steps after which the search gives up, default 200
  --record=FOLDER  where the replay's video and table go; needs imageio[ffmpeg]

From each kept moment it tries every action, restoring the moment's snapshot before each. It keeps the most promising outcomes. The
plan is then replayed in a new environment, without snapshots: the same seed and the same actions give the same game.
"""

import argparse
import itertools
import sys
from typing import NamedTuple

import craftfleet
import numpy as np

GOAL = "collect_stone"
STONE, TREE, TABLE = 3, 6, 11  # in the semantic view
DIRECTIONS = ("move_left", "move_right", "move_up", "move_down")


class Moment(NamedTuple):
  """A moment of the game, and the actions that led to it."""

  snapshot: bytes
  plan: tuple[int, ...]
  facing: str
  info: dict


def distance(info, material):
  """Steps to the nearest cell of the material if nothing stands in the way."""
  cells = np.argwhere(info["semantic"] == material)
  return np.abs(cells - info["player_pos"]).sum(axis=1).min(initial=1000)


def promise(moment):
  """How far a moment is on the way to a stone; higher is better. Two pieces of wood make a table and a pickaxe."""
  info, inventory, unlocked = moment.info, moment.info["inventory"], moment.info["achievements"]
  if unlocked[GOAL]:
    return 5, 0
  if inventory["wood_pickaxe"]:
    return 4, -distance(info, STONE)
  if unlocked["place_table"] and inventory["wood"]:
    return 3, -distance(info, TABLE)
  if unlocked["place_table"] or not inventory["wood"]:
    return 2 * bool(unlocked["place_table"]), -distance(info, TREE)
  return 1, inventory["wood"]


def outcomes(env, moment):
  """What each action leads to."""
  for action, name in enumerate(craftfleet.ACTIONS):
    env.restore(moment.snapshot)
    _, _, done, info = env.step(action)
    if not done:
      yield Moment(env.snapshot(), (*moment.plan, action), name if name in DIRECTIONS else moment.facing, info)


def different(moments):
  """Of moments in which the player stands at the same place, looks the same way and owns the same things, the first."""
  kept = {}
  for moment in moments:
    kept.setdefault((tuple(moment.info["player_pos"]), moment.facing, *moment.info["inventory"].values()), moment)
  return kept.values()


def search(seed, beam, depth):
  """The shortest plan that the beam finds, or None."""
  env = craftfleet.Env(seed=seed)
  env.reset()
  info = env.step(0)[3]
  kept = [Moment(env.snapshot(), (0,), "move_down", info)]
  for _ in range(depth):
    found = different(itertools.chain.from_iterable(outcomes(env, moment) for moment in kept))
    kept = sorted(found, key=promise, reverse=True)[:beam]
    if kept and kept[0].info["achievements"][GOAL]:
      return kept[0].plan
  return None


def replay(seed, plan, record):
  """Plays the plan from the start; returns the last step's info."""
  env = craftfleet.Env(seed=seed, length=len(plan))  # the recorder writes episodes that end
  if record:
    env = craftfleet.Recorder(env, record)
  env.reset()
  for action in plan:
    info = env.step(action)[3]
  return info


def main():
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("--seed", type=int, default=1)
  parser.add_argument("--beam", type=int, default=24)
  parser.add_argument("--depth", type=int, default=200)
  parser.add_argument("--record", metavar="FOLDER")
  arguments = parser.parse_args()
  plan = search(arguments.seed, arguments.beam, arguments.depth)
  if plan is None:
    sys.exit(f"no plan in {arguments.depth} steps, try a larger --beam or another --seed")
  print(f"{GOAL} in world {arguments.seed} takes {len(plan)} steps:")
  print(", ".join(f"{craftfleet.ACTIONS[action]} x{len(list(same))}" for action, same in itertools.groupby(plan)))
  info = replay(arguments.seed, plan, arguments.record)
  print("replayed, unlocked:", ", ".join(name for name, count in info["achievements"].items() if count))


if __name__ == "__main__":
  main()
