"""The game as a Gymnasium environment: CraftFleet/Crafter-v1 and CraftFleet/CrafterNoReward-v1."""

from __future__ import annotations

import os
from typing import Any, SupportsIndex

import gymnasium
import numpy as np

from craftfleet import _arguments, _engine
from craftfleet._playable import Playable


class GymnasiumEnv(Playable, gymnasium.Env[np.ndarray, int]):
  """`gymnasium.make("CraftFleet/Crafter-v1", env="crafter:numbers=easy-x2")`.

  A death terminates an episode, its `length` truncates it. Arguments are those of craftfleet.Env; `seed` is that of reset().
  `render_mode="rgb_array"` draws `render_size` pixels, by default those of observations; drawing does not change the game.
  """

  metadata = {"render_modes": ["rgb_array"], "render_fps": 10}

  def __init__(
      self, env: str = "crafter", area: Any = (64, 64), view: Any = (9, 9), size: Any = (64, 64), reward: bool = True,
      length: int | None = 10000, textures: str | os.PathLike[str] | None = None, render_mode: str | None = None,
      render_size: Any = None) -> None:
    Playable.__init__(self, env, area, view, size, reward, length, textures, seed=0)
    self.render_mode = _arguments.render_mode(render_mode)
    self._render_size = None if render_size is None else _arguments.picture_size("render_size", render_size, self._setup)

  def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[np.ndarray, dict[str, Any]]:
    """Starts the next episode, or with a seed its first one; returns observation and info.

    Seeds are 0..2^63-1. Without any, the first call takes a random one.
    """
    if seed is not None:
      seed = _arguments.integer("seed", seed, 0, _arguments.MAX_SEED)
    super().reset(seed=seed)
    if seed is None and not self._game.started:
      seed = int(self.np_random.integers(2**31 - 1))
    if seed is not None:
      self._game = _engine.Game(self._setup, seed)
    return self._reset(), self._info()

  def step(self, action: SupportsIndex) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
    """Takes an action, 0..16; returns observation, reward, terminated, truncated and info (as of craftfleet.Env)."""
    observation, reward, terminated, truncated = self._step(action)
    return observation, reward if self._reward else 0.0, terminated, truncated, self._info(reward)

  def render(self) -> np.ndarray | None:
    """The picture of the current moment with render_mode="rgb_array", otherwise None."""
    return self.picture(self._render_size) if self.render_mode == "rgb_array" else None
