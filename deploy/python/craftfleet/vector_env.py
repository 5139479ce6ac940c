"""craftfleet.VectorEnv: many games in one array, stepped by threads of the engine."""

from __future__ import annotations

import copy
import os
from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode

from craftfleet import _arguments, _engine, _lanes

_AUTORESET = {
    AutoresetMode.NEXT_STEP: _engine.Autoreset.NEXT_STEP,
    AutoresetMode.SAME_STEP: _engine.Autoreset.SAME_STEP,
    AutoresetMode.DISABLED: _engine.Autoreset.DISABLED,
}
# The engine's arrays, which a copy makes anew.
_MADE_ANEW = ("_batch", "_observations", "_infos", "_ends", "_everyone")
MAX_LANES = 1 << 20
MAX_THREADS = 1 << 10


class VectorEnv(gymnasium.vector.VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
  """`num_envs` games with Gymnasium's vector interface.

  Each call returns new arrays, as Gymnasium's vector environments do. With `copy=False`, for speed, observations, rewards, ends and
  infos are arrays that are allocated once, and each call overwrites what the previous one returned.
  `torch.from_dlpack(observations)` shares their memory.

  The games do not depend on `threads`: lane i plays what GymnasiumEnv plays after `reset(seed=seed + i)`. step() releases the
  GIL. Use an object from one thread at a time: a call while another thread is in one raises RuntimeError. So do reset() and
  step() after close().

  Args:
    num_envs: number of games, the lanes.
    threads: threads that step them, the caller's included.
    autoreset_mode: when a lane whose episode has ended starts its next one: NEXT_STEP, SAME_STEP or DISABLED.
    copy: whether calls return new arrays.
    semantic: whether infos have the semantic views, 4 KB a lane.
    render_mode, render_size: as of GymnasiumEnv; render() returns a picture of each lane.
    max_episode_steps: as gymnasium.make_vec() passes it: episodes are truncated after so many steps, if `length` is not less.
    Others: as of craftfleet.Env.
  """

  def __init__(
      self, num_envs: int, *, threads: int = 1, env: str = "crafter", area: Any = (64, 64), view: Any = (9, 9), size: Any = (64, 64),
      reward: bool = True, length: int | None = 10000, textures: str | os.PathLike[str] | None = None,
      autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP, copy: bool = True, semantic: bool = False,
      render_mode: str | None = None, render_size: Any = None, max_episode_steps: int | None = None) -> None:
    self._arguments = {name: value for name, value in locals().items() if name not in ("self", "__class__")}
    self.num_envs = _arguments.integer("num_envs", num_envs, 1, MAX_LANES)
    self.autoreset_mode = _autoreset_mode(autoreset_mode)
    self.render_mode = _arguments.render_mode(render_mode)
    self.metadata = {"render_modes": ["rgb_array"], "render_fps": 10, "autoreset_mode": self.autoreset_mode}
    if max_episode_steps is not None:
      most = _arguments.integer("max_episode_steps", max_episode_steps, 1, 10**9)
      length = min(_arguments.integer("length", 0 if length is None else length, 0, 10**9) or most, most)
    setup = _arguments.setup(env, area, view, size, length, textures)
    self._arguments["textures"] = setup.arguments[5] or None  # a copy may be made in another folder
    width, height = setup.arguments[3]
    self._render_size = (width, height) if render_size is None else _arguments.picture_size("render_size", render_size, setup)
    self._copy = bool(copy)
    self._batch = _engine.Batch(
        setup, self.num_envs, _arguments.integer("threads", threads, 1, MAX_THREADS), _AUTORESET[self.autoreset_mode],
        bool(reward), bool(semantic))
    self._everyone = np.ones(self.num_envs, np.bool_)
    self._everyone.flags.writeable = False  # all masks of all calls are this array
    self._observations, self._infos = _named(self._batch.rows, self._everyone)
    self._ends = (self._batch.rewards, self._batch.terminated, self._batch.truncated)
    self.single_observation_space = gymnasium.spaces.Box(0, 255, (height, width, 3), np.uint8)
    self.single_action_space = gymnasium.spaces.Discrete(len(_engine.ACTIONS))
    self.observation_space = self._made_space = gymnasium.vector.utils.batch_space(self.single_observation_space, self.num_envs)
    self.action_space = gymnasium.vector.utils.batch_space(self.single_action_space, self.num_envs)

  def reset(
      self, *, seed: int | Sequence[int | None] | None = None,
      options: dict[str, Any] | None = None) -> tuple[np.ndarray, dict[str, Any]]:
    """Starts the next episode of every lane, or of those in `options={"reset_mask": bool array}`.

    Lanes with a seed start its first episode: `seed + i`, or the i-th of a list, which may have None. Lanes that have never been
    reset take random seeds.
    """
    self._check_open()
    seeds, lanes = _lanes.seeds(seed, self.num_envs), _lanes.chosen(options, self.num_envs)
    if seed is not None and not hasattr(seed, "__len__"):
      super().reset(seed=int(seed))
    for lane in lanes:
      if seeds[lane] is None and not self._batch.started(lane):
        seeds[lane] = int(self.np_random.integers(2**31 - 1))
    self._batch.reset(lanes, [s is not None for s in seeds], [s or 0 for s in seeds])
    return self._current()

  def step(self, actions: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
    """One action for each lane; returns observations, rewards, terminations, truncations and infos.

    In SAME_STEP, infos has final_obs and final_info of the lanes that ended. ValueError: an action out of 0..16; RuntimeError: a
    lane that is to be reset first. Then no lane has moved.
    """
    self._check_open()
    self._batch.step(_lanes.actions(actions, self.num_envs))
    observations, infos = self._current()
    rewards, terminated, truncated = (end.copy() for end in self._ends) if self._copy else self._ends
    if self.autoreset_mode == AutoresetMode.SAME_STEP:
      infos.update(self._final(terminated | truncated))
    return observations, rewards, terminated, truncated, infos

  def render(self) -> tuple[np.ndarray, ...] | None:
    """A picture of each lane, uint8[height, width, 3], with render_mode="rgb_array"; otherwise None."""
    if self.render_mode is None:
      return None
    width, height = self._render_size
    frames = tuple(np.empty((height, width, 3), np.uint8) for _ in range(self.num_envs))
    for lane, frame in enumerate(frames):
      self._batch.redraw(lane, self._render_size, frame)
    return frames

  def snapshot(self) -> list[bytes]:
    """The game of each lane as bytes. A lane's snapshot also fits GymnasiumEnv and Env with the same arguments."""
    return [self._batch.save(lane) for lane in range(self.num_envs)]

  def restore(self, snapshots: Sequence[bytes]) -> tuple[np.ndarray, dict[str, Any]]:
    """Continues each lane from its snapshot; the same one may be given to many. Returns observations and infos.

    ValueError: damaged, or of other arguments; names the lane. The lanes before it have their snapshots by then.
    """
    if isinstance(snapshots, bytes):
      raise TypeError(f"snapshots of type bytes, want a list with one for each of {self.num_envs} lanes")
    if len(snapshots) != self.num_envs:
      raise ValueError(f"{len(snapshots)} snapshots, want one for each of {self.num_envs} lanes")
    for lane, snapshot in enumerate(snapshots):
      _arguments.check_snapshot(f"snapshots[{lane}]", snapshot)
      try:
        self._batch.restore(lane, snapshot)
      except ValueError as error:
        raise ValueError(f"lane {lane}: {error}") from None
    return self._current()

  def __getstate__(self) -> dict[str, Any]:
    snapshots = {lane: self._batch.save(lane) for lane in range(self.num_envs) if self._batch.started(lane)}
    # Without the space that it has made, which is larger than the games: its random numbers are enough.
    attributes = {
        name: value for name, value in self.__dict__.items() if name not in _MADE_ANEW and value is not self._made_space}
    random = self._made_space._np_random  # pylint: disable=protected-access
    return {"attributes": attributes, "snapshots": snapshots, "space_random": random}

  def __setstate__(self, state: dict[str, Any]) -> None:
    VectorEnv.__init__(self, **state["attributes"]["_arguments"])
    self._made_space._np_random = state["space_random"]  # pylint: disable=protected-access
    self.__dict__.update(state["attributes"])
    for lane, snapshot in state["snapshots"].items():
      self._batch.restore(lane, snapshot)

  def __copy__(self) -> VectorEnv:
    return copy.deepcopy(self)

  def _check_open(self) -> None:
    if self.closed:
      raise RuntimeError("this VectorEnv is closed, want a new one")

  def _current(self) -> tuple[np.ndarray, dict[str, Any]]:
    if self._copy:
      return _named({name: row.copy() for name, row in self._batch.rows.items()}, self._everyone)
    return self._observations, {name: dict(info) if isinstance(info, dict) else info for name, info in self._infos.items()}

  def _final(self, ended: np.ndarray) -> dict[str, Any]:
    """What infos have of the lanes that ended in a step with SAME_STEP."""
    if not ended.any():
      return {}
    frames, infos = _named(self._batch.final_rows, ended)
    observations = np.full(self.num_envs, None, object)
    for lane in np.flatnonzero(ended):
      observations[lane] = frames[lane].copy()
    return {
        "final_obs": observations, "_final_obs": ended, "final_info": copy.deepcopy(infos) if self._copy else infos,
        "_final_info": ended}


def _autoreset_mode(mode: AutoresetMode | str) -> AutoresetMode:
  try:
    return AutoresetMode(mode)
  except ValueError:
    raise ValueError(f"autoreset_mode {mode!r}, want one of {[known.value for known in AutoresetMode]}") from None


def _named(rows: dict[str, np.ndarray], mask: np.ndarray) -> tuple[np.ndarray, dict[str, Any]]:
  """Observations, and infos as Gymnasium has them: an array for each name, and `_name`: the lanes that have it."""
  infos: dict[str, Any] = {}
  for name in ("inventory", "achievements", "discount", "semantic", "player_pos", "reward"):
    if name not in rows:
      continue
    infos[name], infos[f"_{name}"] = rows[name], mask
    if name in ("inventory", "achievements"):
      names = _engine.ITEMS if name == "inventory" else _engine.ACHIEVEMENTS
      infos[name] = {key: value for i, n in enumerate(names) for key, value in ((n, rows[name][:, i]), (f"_{n}", mask))}
  return rows["observations"], infos
