"""What Env and GymnasiumEnv share: one game, its pictures, infos, snapshots and copies."""

from __future__ import annotations

import copy
from typing import Any

import gymnasium
import numpy as np

from craftfleet import _arguments, _engine


class Playable:
  """One game. Use it from one thread at a time. Copies (`copy`, `deepcopy`, `pickle`) are exact clones."""

  def __init__(self, env: str, area: Any, view: Any, size: Any, reward: bool, length: Any, textures: Any, seed: int) -> None:
    self._setup = _arguments.setup(env, area, view, size, length, textures)
    _, self._area, _, self._size, _, _ = self._setup.arguments
    self._reward = bool(reward)
    self._game = _engine.Game(self._setup, seed)
    self.restores = 0  # calls of restore()
    self._make_observation_space()
    self.action_space = gymnasium.spaces.Discrete(len(_engine.ACTIONS))

  @property
  def action_names(self) -> list[str]:
    """The names of the actions, by number."""
    return list(_engine.ACTIONS)

  def picture(self, size: Any = None) -> np.ndarray:
    """Draws the current moment, at the size of observations or another: uint8[height, width, 3].

    The game does not change. By night the noise is that of the last observation.
    """
    pixels, frame = self._canvas(size)
    self._game.redraw(pixels, frame)
    return frame

  def snapshot(self) -> bytes:
    """The whole game as bytes, about 10.5 KB for 64x64 cells. RuntimeError: before reset().

    The count of a wrapper is not in it, such as that of gymnasium.make(max_episode_steps=...): limit episodes by `length`, which is.
    """
    return self._game.save()

  def restore(self, snapshot: bytes) -> np.ndarray:
    """Continues from snapshot() of an environment with the same arguments; returns the observation of that moment.

    ValueError: damaged, or of other arguments; the game is then unchanged.
    """
    _arguments.check_snapshot("snapshot", snapshot)
    self._game.restore(snapshot)
    self.restores += 1
    return self.picture()

  def __getstate__(self) -> dict[str, Any]:
    # Without the space that it has made, which is larger than the game: its random numbers are enough.
    state = {name: value for name, value in self.__dict__.items() if value is not self._made_space}
    return {**state, "space_random": self._made_space._np_random}  # pylint: disable=protected-access

  def __setstate__(self, state: dict[str, Any]) -> None:
    attributes = dict(state)
    random = attributes.pop("space_random")
    self._size = attributes["_size"]
    self._make_observation_space()
    self._made_space._np_random = random  # pylint: disable=protected-access
    self.__dict__.update(attributes)

  def __copy__(self) -> Any:
    return copy.deepcopy(self)

  def _make_observation_space(self) -> None:
    self.observation_space = self._made_space = gymnasium.spaces.Box(0, 255, (self._size[1], self._size[0], 3), np.uint8)

  def _canvas(self, size: Any) -> tuple[_arguments.Pair, np.ndarray]:
    pixels = self._size if size is None else _arguments.pair("size", size)
    return pixels, np.empty((pixels[1], pixels[0], 3), np.uint8)

  def _reset(self) -> np.ndarray:
    _, frame = self._canvas(None)
    self._game.reset(frame)
    return frame

  def _step(self, action: Any) -> tuple[np.ndarray, float, bool, bool]:
    _, frame = self._canvas(None)
    number = _arguments.integer("action", action, 0, len(_engine.ACTIONS) - 1)
    reward, terminated, truncated = self._game.step(number, frame)
    return frame, reward, terminated, truncated

  def _info(self, reward: float = 0.0) -> dict[str, Any]:
    game = self._game
    semantic = np.empty(self._area, np.uint8)
    game.semantic(semantic)
    inventory = game.inventory
    return {
        "inventory": dict(zip(_engine.ITEMS, inventory)),
        "achievements": dict(zip(_engine.ACHIEVEMENTS, game.achievements)),
        "discount": 1.0 if inventory[0] > 0 else 0.0,  # the first item is health
        "semantic": semantic,
        "player_pos": np.array(game.position),
        "reward": reward,
    }
