"""craftfleet.Recorder: episodes as files, named and laid out as those of crafter.Recorder (version 1.8.3)."""

from __future__ import annotations

import contextlib
import copy
import datetime
import errno
import json
import os
import pathlib
import socket
import subprocess
import tempfile
import weakref
from collections.abc import Iterator
from typing import Any

import gymnasium
import numpy as np

from craftfleet import _arguments, _programs


class Recorder(gymnasium.Wrapper, gymnasium.utils.RecordConstructorArgs):
  """An environment whose episodes are recorded: `craftfleet.Recorder(craftfleet.Env(), "recordings")`.

  The folder gets a line in stats.jsonl, a video (.mp4, needs imageio[ffmpeg]) and a table (.npz) of each finished episode; the
  latter are named by time, number of achievements and length. Several recorders may share a folder. The game is the same with and
  without a recorder. For craftfleet.Env, where it has crafter's interface, and for Gymnasium environments of this package, where it
  is a gymnasium.Wrapper. Steps after the end of an episode are not recorded, nor is the rest of an episode whose environment was
  restored from a snapshot. With videos, a forked process records from its next episode on.

  Args:
    directory: the folder; None: nothing is recorded.
    save_stats: whether stats.jsonl gets a line.
    save_video: whether videos are made.
    save_episode: whether tables are made.
    video_size: width and height of videos in pixels; one integer stands for both.
  """

  def __new__(cls, env: Any = None, *arguments: Any, **named: Any) -> Any:
    # A copy is made without arguments.
    if env is not None and not isinstance(env, gymnasium.Env) and not isinstance(env, gymnasium.vector.VectorEnv):
      if cls is not Recorder:
        raise TypeError(f"{cls.__name__} of {type(env).__name__}, want an environment of Gymnasium: subclasses of Recorder wrap no others")
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

  def __copy__(self) -> Any:
    return copy.deepcopy(self)  # as the environment's

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
    if not hasattr(env, "restores"):
      raise TypeError(f"{type(env).__name__} is no environment of craftfleet, want craftfleet.Env or one of gymnasium.make")
    self._env, self._restores = env, env.restores
    self._folder = _programs.absolute(directory or ".")
    self._save_stats, self._save_table = bool(directory and save_stats), bool(directory and save_episode)
    self._video = _Video(env, video_size) if directory and save_video else None
    self._first: np.ndarray | None = None  # the observation of the reset; None: no episode that is recorded
    if directory:
      self._folder.mkdir(parents=True, exist_ok=True)

  def begin(self, observation: np.ndarray) -> None:
    self.drop()
    self._restores = self._env.restores
    if self._video is not None:
      self._video.begin(self._folder)
    if self._save_stats or self._save_table or self._video is not None:
      self._first, self._length, self._reward = np.array(observation), 0, 0.0
      self._rows: list[dict[str, Any]] = []

  def add(self, action: Any, observation: np.ndarray, done: bool, info: dict[str, Any]) -> None:
    # What follows is of another episode, or of a fork, whose video is that of its parent.
    if self._env.restores != self._restores or self._video is not None and self._video.is_inherited():
      self.drop()
    if self._first is None:
      return
    self._length += 1
    self._reward += info["reward"]
    try:
      if self._video is not None:
        self._video.add()
      if self._save_table:
        self._rows.append(_row(action, observation, done, info))
      if done:
        self._save(info["achievements"])
    except BaseException:
      self.drop()
      raise

  def drop(self) -> None:
    self._first, self._rows = None, []
    if self._video is not None:
      self._video.drop()

  def _save(self, achievements: dict[str, int]) -> None:
    with self._name(achievements) as stem:
      if self._save_stats:
        stats = {"length": self._length, "reward": round(self._reward, 1)}
        _append_line(self._folder / "stats.jsonl", stats | {f"achievement_{name}": count for name, count in achievements.items()})
      if self._video is not None:
        self._video.save(self._folder / f"{stem}.mp4", self._length + 1)
      if self._save_table:
        _write_table(self._folder / f"{stem}.npz", self._first, self._rows)
    self.drop()

  @contextlib.contextmanager
  def _name(self, achievements: dict[str, int]) -> Iterator[str]:
    """A name that no file has, nor any other recorder takes meanwhile: a second later if it is taken."""
    unlocked = sum(count > 0 for count in achievements.values())
    time = datetime.datetime.now()
    while True:
      stem = f"{time:%Y%m%dT%H%M%S}-ach{unlocked}-len{self._length}"
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


def _append_line(path: pathlib.Path, stats: dict[str, Any]) -> None:
  line = (json.dumps(stats) + "\n").encode()
  with open(path, "ab", buffering=0) as file:
    begin = file.seek(0, os.SEEK_END)
    if file.write(line) < len(line):
      file.truncate(begin)
      raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))


class _Video:
  """A video, written by ffmpeg while the episode is played: ten steps a second."""

  def __init__(self, env: Any, size: Any) -> None:
    self._env = env
    self._size = _arguments.picture_size("video_size", size, env._setup)  # pylint: disable=protected-access
    try:
      import imageio_ffmpeg  # optional
    except ImportError as error:
      raise ImportError(f"save_video=True: {error}, want: pip install 'imageio[ffmpeg]', or save_video=False") from None
    self._ffmpeg, self._count = imageio_ffmpeg.get_ffmpeg_exe(), imageio_ffmpeg.count_frames_and_secs
    self._owner = os.getpid()
    self._abandon: weakref.finalize | None = None  # of the video that is being written

  def __reduce__(self) -> Any:
    raise TypeError("a recorder of videos cannot be copied or pickled, want a new one, or save_video=False")

  def begin(self, folder: pathlib.Path) -> None:
    self._owner = os.getpid()
    width, height = self._size
    with contextlib.ExitStack() as undo:
      self._path = _unfinished(folder, ".mp4")
      undo.callback(self._path.unlink)
      # A socket, because a pipe would not end while a fork has a copy of it.
      self._pictures, pictures = socket.socketpair()
      undo.enter_context(self._pictures)
      with pictures:
        for end in (self._pictures, pictures):
          end.setblocking(True)  # whatever socket.setdefaulttimeout() says
        self._encoder = subprocess.Popen(  # pylint: disable=consider-using-with  # _abandon_video() ends it
            [self._ffmpeg, "-y", "-v", "warning",
             "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", "10", "-i", "-",
             "-vf", "scale=ceil(iw/16)*16:ceil(ih/16)*16", "-pix_fmt", "yuv420p", self._path],
            stdin=pictures, stdout=subprocess.DEVNULL, start_new_session=True)  # Ctrl-C reaches this process alone
      undo.pop_all()
    # Programs for crafter close no recorder.
    self._abandon = weakref.finalize(self, _abandon_video, self._owner, self._pictures, self._encoder, self._path)
    self.add()

  def add(self) -> None:
    try:
      self._pictures.sendall(self._env.picture(self._size))
    except ConnectionError as error:
      raise OSError(f"{self._path}: ffmpeg has ended early ({error}), see what it printed") from None

  def save(self, path: pathlib.Path, pictures: int) -> None:
    self._pictures.shutdown(socket.SHUT_WR)
    self._encoder.wait()
    with contextlib.suppress(RuntimeError):  # the video is damaged
      if self._count(str(self._path))[0] == pictures:
        self._path.rename(path)
        return
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))  # which ffmpeg does not report

  def is_inherited(self) -> bool:
    """Whether another process has begun it, of which this one is a fork."""
    return os.getpid() != self._owner

  def drop(self) -> None:
    if self._abandon is not None:
      self._abandon()


def _row(action: Any, observation: np.ndarray, done: bool, info: dict[str, Any]) -> dict[str, Any]:
  """What the table has of a step."""
  row = {"image": np.array(observation), "action": action, "reward": info["reward"], "done": done}
  row.update((name, np.array(info[name])) for name in ("discount", "semantic", "player_pos"))
  row.update((f"achievement_{name}", count) for name, count in info["achievements"].items())
  row.update((f"ainventory_{name}", count) for name, count in info["inventory"].items())
  return row


def _write_table(path: pathlib.Path, first: np.ndarray, rows: list[dict[str, Any]]) -> None:
  """An .npz file: for each name an array with a row for the reset and for each step."""
  # The reset has an image; everything else of its row is zero.
  reset = {name: np.zeros_like(value) for name, value in rows[0].items()} | {"image": first}
  columns = {name: np.array([row[name] for row in (reset, *rows)]) for name in reset}
  unfinished = _unfinished(path.parent, ".npz")
  try:
    np.savez_compressed(unfinished, **columns)
    unfinished.rename(path)
  finally:
    unfinished.unlink(missing_ok=True)


def _abandon_video(owner: int, pictures: socket.socket, encoder: subprocess.Popen, path: pathlib.Path) -> None:
  pictures.close()
  if os.getpid() == owner:  # not in a fork
    encoder.kill()
    encoder.wait()
    path.unlink(missing_ok=True)


def _unfinished(folder: pathlib.Path, suffix: str) -> pathlib.Path:
  """A new file under a name that no other recorder has."""
  descriptor, path = tempfile.mkstemp(suffix, ".recording-", folder)
  os.fchmod(descriptor, 0o644)
  os.close(descriptor)
  return pathlib.Path(path)
