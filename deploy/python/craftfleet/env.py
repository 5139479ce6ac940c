"""craftfleet.Env: in place of crafter.Env."""

from __future__ import annotations

import os
from typing import Any, SupportsIndex

import numpy as np

from craftfleet import _arguments
from craftfleet._playable import Playable


class Env(Playable):
  """The game with the interface of `crafter.Env` (version 1.8.3): the same arguments, results and episodes.

  Args:
    area: width and height of the world in cells, 4..250 each.
    view: width and height of the picture in cells, up to 63: the height has the inventory's rows (2 with a width of 9) and at
      least one more. One integer stands for both.
    size: width and height of observations in pixels, from 2 for each cell of the view to 2048.
    reward: whether step() returns rewards; info["reward"] always has them.
    length: steps after which an episode ends, up to 10^9; 0 or None: no limit.
    seed: any 64-bit integer; the same seed gives the same episodes. None: a random one, from numpy.random.
    env: CrafterOOD's variants, such as "crafter:appearance=25/25/25/25,numbers=easy-x2,inventory=off".
    textures: None: this project's own; "crafter": those of the installed package crafter; otherwise a folder of PNG files.
  """

  # Crafter's environments have these attributes for libraries that expect them.
  reward_range = None
  metadata = None

  def __init__(
      self, area: Any = (64, 64), view: Any = (9, 9), size: Any = (64, 64), reward: bool = True, length: int | None = 10000,
      seed: int | None = None, *, env: str = "crafter", textures: str | os.PathLike[str] | None = None) -> None:
    seed = np.random.randint(0, 2**31 - 1) if seed is None else _arguments.seed(seed)
    super().__init__(env, area, view, size, reward, length, textures, seed)

  def reset(self) -> np.ndarray:
    """Starts the next episode; returns the first observation, uint8[height, width, 3]."""
    return self._reset()

  def step(self, action: SupportsIndex) -> tuple[np.ndarray, float, bool, dict[str, Any]]:
    """Takes an action, 0..16; returns observation, reward, done and info.

    info: inventory and achievements (counts by name), discount (0.0 at a death, otherwise 1.0), semantic (uint8[width, height]:
    materials 1..12, objects 13..18), player_pos (x and y in cells), reward.
    """
    observation, reward, terminated, truncated = self._step(action)
    return observation, reward if self._reward else 0.0, terminated or truncated, self._info(reward)

  def render(self, size: Any = None) -> np.ndarray:
    """Draws the current moment as crafter.Env.render() does.

    By night it takes noise from the game's random stream, as the original does: the game continues differently than without
    the call. picture() does not.
    """
    pixels, frame = self._canvas(size)
    self._game.draw_from_stream(pixels, frame)
    return frame

  def close(self) -> None:
    """Does nothing; for programs that close their environments."""
