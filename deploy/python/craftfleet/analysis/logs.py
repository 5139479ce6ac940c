"""Episodes of a run, and what they amount to."""

from __future__ import annotations

import dataclasses
import gzip
import json
import os
import zlib

import numpy as np

from ._cli import Refusal, reason

ACHIEVEMENTS = (
    "collect_coal", "collect_diamond", "collect_drink", "collect_iron", "collect_sapling", "collect_stone", "collect_wood",
    "defeat_skeleton", "defeat_zombie", "eat_cow", "eat_plant", "make_iron_pickaxe", "make_iron_sword", "make_stone_pickaxe",
    "make_stone_sword", "make_wood_pickaxe", "make_wood_sword", "place_furnace", "place_plant", "place_stone", "place_table",
    "wake_up")
RECENT = 100  # episodes over which learning curves average the reward
FEWEST_EPISODES = 10  # means over fewer are too noisy to draw
_MOST = 10**12  # of any number of an episode: sums of them fit 64 bits
_KEYS = ("length", "reward", *(f"achievement_{name}" for name in ACHIEVEMENTS))


def crafter_score(rates: np.ndarray) -> np.ndarray:
  """The Crafter score of success rates in percent, [..., 22]: exp(mean of ln(1 + rate)) - 1."""
  return np.expm1(np.log1p(rates).mean(axis=-1))


@dataclasses.dataclass(frozen=True, eq=False)
class Curve:
  """A learning curve, with a point after each episode."""

  episodes: np.ndarray
  steps: np.ndarray  # of finished episodes
  reward: np.ndarray  # mean of the last 100 episodes
  score: np.ndarray  # over all episodes so far

  def __len__(self) -> int:
    return len(self.steps)

  def index_at(self, steps: int) -> int:
    """The last point at `steps` or before; -1: there is none."""
    return int(np.searchsorted(self.steps, steps, side="right")) - 1


@dataclasses.dataclass(frozen=True, eq=False)
class Episodes:
  """Episodes in the order of their log; n is their number, which may be 0."""

  length: np.ndarray  # [n], steps
  tenths: np.ndarray  # [n], the reward in tenths, which are exact
  counts: np.ndarray  # [n, 22], how often each achievement was unlocked

  def __len__(self) -> int:
    return len(self.length)

  def first(self, number: int) -> Episodes:
    return Episodes(self.length[:number], self.tenths[:number], self.counts[:number])

  @property
  def success(self) -> np.ndarray:
    """Success rate of each achievement in percent, [22]."""
    return 100 * (self.counts > 0).mean(axis=0) if len(self) else np.zeros(len(ACHIEVEMENTS))

  @property
  def score(self) -> float:
    return float(crafter_score(self.success))

  @property
  def reward(self) -> float:
    return float(self.tenths.mean()) / 10 if len(self) else 0.0

  @property
  def recent_reward(self) -> float:
    """Mean of the last 100 episodes."""
    return float(self.tenths[-RECENT:].mean()) / 10 if len(self) else 0.0

  @property
  def unlocked(self) -> int:
    return int((self.counts > 0).any(axis=0).sum()) if len(self) else 0

  def curve(self) -> Curve:
    number = np.arange(1, len(self) + 1)
    rates = 100 * np.cumsum(self.counts > 0, axis=0) / number[:, None]
    sums = np.concatenate([[0], np.cumsum(self.tenths)])
    begin = np.maximum(number - RECENT, 0)
    return Curve(number, np.cumsum(self.length), (sums[number] - sums[begin]) / (number - begin) / 10, crafter_score(rates))


NO_EPISODES = Episodes(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, len(ACHIEVEMENTS)), np.int64))


def _problem(episode: object) -> str:
  """What is wrong with a line of a log; "" if nothing is."""
  if not isinstance(episode, dict):
    return "not a JSON object"
  for key in _KEYS:
    value = episode.get(key)
    if key not in episode:
      return f'no number "{key}"' if key == "reward" else f'no "{key}"'
    kind = (int, float) if key == "reward" else int
    low = {"length": 1, "reward": -_MOST}.get(key, 0)
    if isinstance(value, bool) or not isinstance(value, kind) or not low <= value <= _MOST:
      return f'"{key}" is {json.dumps(value)}, want {"a number" if key == "reward" else f"at least {low}, at most {_MOST}"}'
  return "" if len(episode) == len(_KEYS) else f"has {len(episode)} keys, want {len(_KEYS)}"


def read_log(path: str, is_final: bool = False) -> Episodes:
  """The episodes of a stats.jsonl, plain or gzipped, without a last line that is being written.

  Refusal: it cannot be read, has a line that is no episode, or `is_final` and its last line is incomplete; names the line.
  """
  try:
    with open(path, "rb") as file:
      content = file.read()
    if content[:2] == b"\x1f\x8b":
      content = gzip.decompress(content)
  except (OSError, EOFError, zlib.error) as error:
    raise Refusal(reason(error) if isinstance(error, OSError) and error.filename else f"{path}: {error}") from None
  lines = content.split(b"\n")
  rows = []
  for number, line in enumerate(lines[:-1], 1):
    try:
      episode = json.loads(line)
    except (ValueError, RecursionError):
      episode = None
    problem = _problem(episode)
    if problem:
      raise Refusal(f"{path}:{number}: {problem}")
    rows.append([episode["length"], round(10 * episode["reward"]), *(episode[key] for key in _KEYS[2:])])
  if lines[-1] and is_final:
    raise Refusal(f"{path}:{len(lines)}: the line is incomplete")
  if not rows:
    return NO_EPISODES
  table = np.array(rows, np.int64)
  return Episodes(table[:, 0], table[:, 1], table[:, 2:])


def find_log(folder: str, name: str) -> str:
  """The path of a log in `folder`, plain or gzipped; "" if there is neither."""
  paths = (os.path.join(folder, file) for file in (name, name + ".gz"))
  return next((path for path in paths if os.path.lexists(path)), "")
