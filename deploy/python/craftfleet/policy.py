"""craftfleet.Policy: the actions of a trained agent, computed by `craftfleet policy`, the programs' own network."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import tempfile
import threading
from typing import Any

import numpy as np

from craftfleet import _programs

_MOST_GAMES = 4096

class Policy:
  """The policy of a run's newest checkpoint, or of a checkpoint. An episode of one game:

      policy = craftfleet.Policy("runs/first")
      env = craftfleet.Env(env=policy.env, size=policy.frame_size)
      policy.reset()
      observation, reward, done = env.reset(), 0.0, False
      while not done:
        observation, reward, done, _ = env.step(policy(observation, reward, starts=False))

  It follows the games from call to call, because agents may have a state: pass every observation of each game in turn. It runs a
  process of its own until close(), which an interrupted call does. Use an object from one thread at a time: a call while another
  thread is in one raises RuntimeError. So does a call in a forked process. ValueError and RuntimeError carry the program's message.

  Attributes:
    agent: its name. env: the environment that it was trained on. env_steps: steps of training. frame_size: pixels of observations.
    needs_rewards: whether calls need the rewards.
  """

  def __init__(self, checkpoint: str | os.PathLike[str], *, deterministic: bool = False, seed: int = 0) -> None:
    self._games = 0
    self._begins = True  # new episodes, with the next call
    self._owner, self._busy = os.getpid(), threading.Lock()
    self._errors = tempfile.TemporaryFile()  # pylint: disable=consider-using-with  # close() closes it
    self._process = _programs.start(
        "policy", _programs.flags(checkpoint=_programs.absolute(checkpoint), deterministic=deterministic, seed=seed),
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._errors)
    line = self._process.stdout.readline()
    if not line:
      raise ValueError(self._failure())
    about = json.loads(line)
    self.agent: str = about["agent"]
    self.env: str = about["env"]
    self.env_steps: int = about["env_steps"]
    self.frame_size: int = about["frame_size"]
    self.needs_rewards: bool = about["has_memory"]

  def __call__(self, observations: Any, rewards: Any = None, starts: Any = None) -> Any:
    """The action for an observation, uint8[H,W,3], or int64[n] for those of n games, uint8[n,H,W,3]; n is 1..4096.

    Args:
      observations: of the same games in each call.
      rewards: those that came with them; only agents with `needs_rewards` need them.
      starts: whether an episode begins with the observation, for all games or for each. In the first call and in that after
        reset() all begin one; later calls need it. Of VectorEnv it is `terminated | truncated`, with SAME_STEP of the step that
        returned the observations, with NEXT_STEP (the default) of the step before that one; with DISABLED it is the reset_mask
        after a reset(), and otherwise False.
    """
    if os.getpid() != self._owner:
      raise RuntimeError(f"its program is that of process {self._owner}, want a Policy of this process's own")
    if not self._busy.acquire(blocking=False):
      raise RuntimeError("another thread is in a call of this Policy, want one at a time")
    try:
      return self._act(observations, rewards, starts)
    finally:
      self._busy.release()

  def reset(self) -> None:
    """The next call begins new episodes in all games, whatever its `starts`."""
    self._begins = True

  def _act(self, observations: Any, rewards: Any, starts: Any) -> Any:
    frames = np.ascontiguousarray(observations)
    size = self.frame_size
    if frames.dtype != np.uint8 or frames.ndim not in (3, 4) or frames.shape[-3:] != (size, size, 3):
      raise ValueError(f"observations are {frames.dtype}{list(frames.shape)}, want uint8[{size}, {size}, 3] or uint8[n, {size}, {size}, 3]")
    games = frames.shape[0] if frames.ndim == 4 else 1
    if games < 1:
      raise ValueError("observations of 0 games, want one or more")
    if self._games not in (0, games):
      raise ValueError(f"observations of {games} games, want {self._games} as before, or a new Policy for another number of games")
    if games > _MOST_GAMES:
      raise ValueError(f"observations of {games} games, want at most {_MOST_GAMES}")
    if starts is None and not self._begins:
      raise ValueError("starts is missing: pass whether an episode begins with the observation, or call reset() before new episodes")
    if rewards is None and self.needs_rewards and not self._begins:
      raise ValueError(f"{self.agent} remembers achievements: pass the rewards that came with the observations")
    rewards = self._each("rewards", 0 if rewards is None else rewards, games, "<f4")
    starts = self._each("starts", False if starts is None else starts, games, np.bool_) | self._begins
    request = games.to_bytes(4, "little") + starts.tobytes() + rewards.tobytes() + frames.tobytes()
    actions = self._ask(request, games)
    self._games, self._begins = games, False
    return actions if frames.ndim == 4 else int(actions[0])

  def close(self) -> None:
    """Ends the process, unless it is that of the process that forked this one."""
    if os.getpid() != self._owner:
      return
    self._process.kill()
    self._process.wait()
    for stream in (self._process.stdin, self._process.stdout, self._errors):
      with contextlib.suppress(BrokenPipeError):  # of a request that is not sent
        stream.close()

  def __reduce__(self) -> Any:
    raise TypeError("a Policy has a process and cannot be copied or pickled, want a new one with the same arguments")

  def __enter__(self) -> Policy:
    return self

  def __exit__(self, *_: object) -> None:
    self.close()

  def __del__(self) -> None:
    if hasattr(self, "_process"):
      self.close()

  @staticmethod
  def _each(name: str, values: Any, games: int, kind: Any) -> np.ndarray:
    array = np.asarray(values)
    if array.ndim != 0 and array.shape != (games,):
      raise ValueError(f"{name} has shape {array.shape}, want ({games},)")
    return np.ascontiguousarray(np.broadcast_to(array, (games,)), dtype=kind)

  def _ask(self, request: bytes, games: int) -> np.ndarray:
    if self._process.stdin.closed:
      raise RuntimeError("the policy is closed")
    try:
      self._process.stdin.write(request)
      self._process.stdin.flush()
      answer = self._process.stdout.read(games)
    except BrokenPipeError:
      answer = b""
    except BaseException:
      self.close()  # an answer that comes later would be taken for that to the next request
      raise
    if len(answer) != games:
      raise RuntimeError(self._failure())
    return np.frombuffer(answer, np.uint8).astype(np.int64)

  def _failure(self) -> str:
    code = self._process.wait()
    self._errors.seek(0)
    return _programs.failure("policy", code, self._errors.read().decode(errors="replace").splitlines())
