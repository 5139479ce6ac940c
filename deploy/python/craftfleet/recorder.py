"""craftfleet.Recorder: episodes as files, named and laid out as those of crafter.Recorder (version 1.8.3)."""

from __future__ import annotations

import datetime
import json
import os
import pathlib
from typing import Any

import gymnasium
import numpy as np

from craftfleet import _arguments


class Recorder:
  """An environment whose episodes are recorded: `craftfleet.Recorder(craftfleet.Env(), "recordings")`.

  The folder gets a line in stats.jsonl, a video (.mp4, needs imageio[ffmpeg]) and a table (.npz) of each finished episode; the
  latter are named by time, number of achievements and length. The game is the same with and without a recorder. For craftfleet.Env
  and for Gymnasium environments of this package; everything else of the environment is reached through the recorder.
  """

  def __init__(
      self, env: Any, directory: str | os.PathLike[str] | None, save_stats: bool = True, save_video: bool = True,
      save_episode: bool = True, video_size: Any = (512, 512)) -> None:
    if isinstance(env, gymnasium.vector.VectorEnv):
      raise TypeError(f"{type(env).__name__} plays many games, want an environment with one")
    self._env = env
    self._folder = pathlib.Path(directory or ".").expanduser()
    self._writers: list[Any] = []
    if not directory:
      return
    self._folder.mkdir(parents=True, exist_ok=True)
    if save_stats:
      self._writers.append(_Stats())
    if save_video:
      self._writers.append(_Video(getattr(env, "unwrapped", env), _arguments.pair("video_size", video_size)))
    if save_episode:
      self._writers.append(_Table())

  def __getattr__(self, name: str) -> Any:
    if name.startswith("_"):
      raise AttributeError(name)
    return getattr(self._env, name)

  def reset(self, **arguments: Any) -> Any:
    """The environment's reset(). An episode that has not ended is dropped."""
    result = self._env.reset(**arguments)
    observation = result[0] if isinstance(result, tuple) else result
    for writer in self._writers:
      writer.begin(self._folder, observation)
    return result

  def step(self, action: Any) -> Any:
    """The environment's step()."""
    result = self._env.step(action)
    info, done = result[-1], any(result[2:-1])
    for writer in self._writers:
      writer.add(action, result[0], done, info)
    if done:
      stem = self._stem(info) if self._writers else ""
      for writer in self._writers:
        writer.save(self._folder, stem)
    return result

  def close(self) -> None:
    """Drops an unfinished episode and closes the environment."""
    for writer in self._writers:
      writer.drop()
    close = getattr(self._env, "close", None)
    if close is not None:
      close()

  def _stem(self, info: dict[str, Any]) -> str:
    """A name that no file has yet: a second later if it is taken."""
    unlocked = sum(count > 0 for count in info["achievements"].values())
    length = self._writers[0].length
    time = datetime.datetime.now()
    while True:
      stem = f"{time:%Y%m%dT%H%M%S}-ach{unlocked}-len{length}"
      if not any((self._folder / f"{stem}{suffix}").exists() for suffix in (".mp4", ".npz")):
        return stem
      time += datetime.timedelta(seconds=1)


class _Writer:
  """Counts the steps of an episode; what to record of it is added below."""

  length = 0

  def begin(self, folder: pathlib.Path, observation: np.ndarray) -> None:
    self.drop()
    self.length = 0

  def add(self, action: Any, observation: np.ndarray, done: bool, info: dict[str, Any]) -> None:
    self.length += 1

  def save(self, folder: pathlib.Path, stem: str) -> None:
    raise NotImplementedError

  def drop(self) -> None:
    pass


class _Stats(_Writer):
  """A line of stats.jsonl for each episode."""

  def begin(self, folder, observation):
    super().begin(folder, observation)
    self._reward = 0.0

  def add(self, action, observation, done, info):
    super().add(action, observation, done, info)
    self._reward += info["reward"]
    self._achievements = info["achievements"]

  def save(self, folder, stem):
    stats = {"length": self.length, "reward": round(self._reward, 1)}
    stats.update((f"achievement_{name}", count) for name, count in self._achievements.items())
    with open(folder / "stats.jsonl", "a", encoding="utf-8") as file:
      file.write(json.dumps(stats) + "\n")


class _Video(_Writer):
  """A video, written while the episode is played: ten steps a second."""

  def __init__(self, env: Any, size: _arguments.Pair) -> None:
    try:
      import imageio.v2 as imageio  # optional, and slow to import
      import imageio_ffmpeg  # pylint: disable=unused-import  # what imageio writes videos with
    except ImportError as error:
      raise ImportError(f"save_video=True: {error}, want: pip install 'imageio[ffmpeg]', or save_video=False") from None
    self._open, self._env, self._size = imageio.get_writer, env, size
    self._file = None

  def begin(self, folder, observation):
    super().begin(folder, observation)
    self._path = folder / f".recording-{os.getpid()}-{id(self)}.mp4"
    self._file = self._open(self._path)
    self._file.append_data(self._env.picture(self._size))

  def add(self, action, observation, done, info):
    super().add(action, observation, done, info)
    self._file.append_data(self._env.picture(self._size))

  def save(self, folder, stem):
    self._file.close()
    self._file = None
    self._path.rename(folder / f"{stem}.mp4")

  def drop(self):
    if self._file is not None:
      self._file.close()
      self._file = None
      self._path.unlink()


class _Table(_Writer):
  """An .npz file: for each name an array with a row for the reset and for each step."""

  def begin(self, folder, observation):
    super().begin(folder, observation)
    self._first, self._rows = observation, []

  def add(self, action, observation, done, info):
    super().add(action, observation, done, info)
    row = {"image": np.array(observation), "action": action, "reward": info["reward"], "done": done}
    row.update((name, info[name]) for name in ("discount", "semantic", "player_pos"))
    row.update((f"achievement_{name}", count) for name, count in info["achievements"].items())
    row.update((f"ainventory_{name}", count) for name, count in info["inventory"].items())
    self._rows.append(row)

  def save(self, folder, stem):
    # The reset has an image; everything else of its row is zero.
    first = {name: np.zeros_like(value) for name, value in self._rows[0].items()} | {"image": self._first}
    columns = {name: np.array([row[name] for row in (first, *self._rows)]) for name in first}
    np.savez_compressed(folder / f"{stem}.npz", **columns)
