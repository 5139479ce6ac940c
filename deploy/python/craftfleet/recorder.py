"""craftfleet.Recorder: episodes as files, named and laid out as those of crafter.Recorder (version 1.8.3)."""

from __future__ import annotations

import contextlib
import datetime
import errno
import json
import os
import pathlib
import tempfile
from collections.abc import Callable, Iterator
from typing import Any

import gymnasium
import numpy as np

from craftfleet import _arguments


class Recorder(gymnasium.Wrapper, gymnasium.utils.RecordConstructorArgs):
  """An environment whose episodes are recorded: `craftfleet.Recorder(craftfleet.Env(), "recordings")`.

  The folder gets a line in stats.jsonl, a video (.mp4, needs imageio[ffmpeg]) and a table (.npz) of each finished episode; the
  latter are named by time, number of achievements and length. Several recorders may share a folder. The game is the same with and
  without a recorder. For craftfleet.Env, where it has crafter's interface, and for Gymnasium environments of this package, where it
  is a gymnasium.Wrapper. Steps after the end of an episode are not recorded.
  """

  def __new__(cls, env: Any = None, *arguments: Any, **named: Any) -> Any:
    # A copy is made without arguments.
    if env is not None and not isinstance(env, gymnasium.Env) and not isinstance(env, gymnasium.vector.VectorEnv):
      return _CrafterRecorder(env, *arguments, **named)
    return super().__new__(cls)

  def __init__(
      self, env: Any, directory: str | os.PathLike[str] | None, save_stats: bool = True, save_video: bool = True,
      save_episode: bool = True, video_size: Any = (512, 512)) -> None:
    if isinstance(env, gymnasium.vector.VectorEnv):
      raise TypeError(f"{type(env).__name__} plays many games, want an environment with one")
    gymnasium.utils.RecordConstructorArgs.__init__(
        self, directory=directory, save_stats=save_stats, save_video=save_video, save_episode=save_episode, video_size=video_size)
    gymnasium.Wrapper.__init__(self, env)
    self._files = _Files(env.unwrapped, directory, save_stats, save_video, save_episode, video_size)

  def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
    """The environment's reset(). An episode that has not ended is dropped."""
    observation, info = self.env.reset(seed=seed, options=options)
    self._files.begin(observation)
    return observation, info

  def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
    """The environment's step()."""
    observation, reward, terminated, truncated, info = self.env.step(action)
    self._files.add(action, observation, terminated or truncated, info)
    return observation, reward, terminated, truncated, info

  def close(self) -> None:
    """Drops an unfinished episode and closes the environment."""
    self._files.drop()
    super().close()


class _CrafterRecorder:
  """The same with the interface of crafter.Recorder; everything else of the environment is reached through it."""

  def __init__(
      self, env: Any, directory: str | os.PathLike[str] | None, save_stats: bool = True, save_video: bool = True,
      save_episode: bool = True, video_size: Any = (512, 512)) -> None:
    self._env = env
    self._files = _Files(env, directory, save_stats, save_video, save_episode, video_size)

  def __getattr__(self, name: str) -> Any:
    if name.startswith("_"):
      raise AttributeError(name)
    return getattr(self._env, name)

  def reset(self) -> np.ndarray:
    """The environment's reset(). An episode that has not ended is dropped."""
    observation = self._env.reset()
    self._files.begin(observation)
    return observation

  def step(self, action: Any) -> tuple[np.ndarray, float, bool, dict[str, Any]]:
    """The environment's step()."""
    observation, reward, done, info = self._env.step(action)
    self._files.add(action, observation, done, info)
    return observation, reward, done, info

  def close(self) -> None:
    """Drops an unfinished episode and closes the environment."""
    self._files.drop()
    close = getattr(self._env, "close", None)
    if close is not None:
      close()


class _Files:
  """What is recorded of an environment. A file gets its name when it is complete, so that a full disk leaves no half one."""

  def __init__(
      self, env: Any, directory: str | os.PathLike[str] | None, save_stats: bool, save_video: bool, save_episode: bool,
      video_size: Any) -> None:
    self._folder = pathlib.Path(directory or ".").expanduser()
    self._writers: list[_Writer] = []
    self._playing = False
    if not directory:
      return
    self._folder.mkdir(parents=True, exist_ok=True)
    if save_stats:
      self._writers.append(_Stats())
    if save_video:
      self._writers.append(_Video(env, _arguments.pair("video_size", video_size)))
    if save_episode:
      self._writers.append(_Table())

  def begin(self, observation: np.ndarray) -> None:
    self.drop()
    for writer in self._writers:
      writer.begin(self._folder, observation)
    self._playing = True

  def add(self, action: Any, observation: np.ndarray, done: bool, info: dict[str, Any]) -> None:
    if not self._playing or not self._writers:
      return
    try:
      for writer in self._writers:
        writer.add(action, observation, done, info)
      if done:
        with self._name(info) as stem:
          for writer in self._writers:
            writer.save(self._folder, stem)
        self.drop()
    except BaseException:
      self.drop()
      raise

  def drop(self) -> None:
    self._playing = False
    for writer in self._writers:
      writer.drop()

  @contextlib.contextmanager
  def _name(self, info: dict[str, Any]) -> Iterator[str]:
    """A name that no file has, nor any other recorder takes meanwhile: a second later if it is taken."""
    unlocked = sum(count > 0 for count in info["achievements"].values())
    length = self._writers[0].length
    time = datetime.datetime.now()
    while True:
      stem = f"{time:%Y%m%dT%H%M%S}-ach{unlocked}-len{length}"
      claim = self._folder / f".{stem}.claim"
      time += datetime.timedelta(seconds=1)
      try:
        claim.touch(exist_ok=False)
      except FileExistsError:
        continue
      try:
        if not any((self._folder / f"{stem}{suffix}").exists() for suffix in (".mp4", ".npz")):
          yield stem
          return
      finally:
        claim.unlink()


class _Writer:
  """Counts the steps of an episode; what to record of it is added below."""

  length = 0

  def begin(self, folder: pathlib.Path, observation: np.ndarray) -> None:
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
    line = (json.dumps(stats) + "\n").encode()
    with open(folder / "stats.jsonl", "ab", buffering=0) as file:
      begin = file.seek(0, os.SEEK_END)
      written = file.write(line)
      if written < len(line):
        file.truncate(begin)
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), file.name)


class _Video(_Writer):
  """A video, written while the episode is played: ten steps a second."""

  def __init__(self, env: Any, size: _arguments.Pair) -> None:
    try:
      import imageio.v2 as imageio  # optional, and slow to import
      import imageio_ffmpeg  # what imageio writes videos with
    except ImportError as error:
      raise ImportError(f"save_video=True: {error}, want: pip install 'imageio[ffmpeg]', or save_video=False") from None
    self._open, self._count = imageio.get_writer, imageio_ffmpeg.count_frames_and_secs
    self._env, self._size = env, size
    self._file = self._path = None

  def begin(self, folder, observation):
    super().begin(folder, observation)
    self._path = _unfinished(folder, ".mp4")
    self._file = self._open(self._path)
    self._file.append_data(self._env.picture(self._size))

  def add(self, action, observation, done, info):
    super().add(action, observation, done, info)
    self._file.append_data(self._env.picture(self._size))

  def save(self, folder, stem):
    self._file.close()
    self._file = None
    if _frames(self._count, self._path) != self.length + 1:  # ffmpeg does not report that it could not write
      raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), f"{folder / stem}.mp4")
    self._path.rename(folder / f"{stem}.mp4")
    self._path = None

  def drop(self):
    if self._file is not None:
      with contextlib.suppress(OSError):
        self._file.close()
    if self._path is not None:
      self._path.unlink(missing_ok=True)
    self._file = self._path = None


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
    path = _unfinished(folder, ".npz")
    try:
      np.savez_compressed(path, **columns)
      path.rename(folder / f"{stem}.npz")
    finally:
      path.unlink(missing_ok=True)


def _unfinished(folder: pathlib.Path, suffix: str) -> pathlib.Path:
  """A new file under a name that no other recorder has."""
  descriptor, path = tempfile.mkstemp(suffix, ".recording-", folder)
  os.fchmod(descriptor, 0o644)
  os.close(descriptor)
  return pathlib.Path(path)


def _frames(count: Callable[[str], tuple[int, float]], path: pathlib.Path) -> int:
  """The pictures of a video; 0 if it is damaged."""
  try:
    return count(str(path))[0]
  except RuntimeError:
    return 0
