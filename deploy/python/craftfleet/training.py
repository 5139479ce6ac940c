"""craftfleet.train, craftfleet.evaluate and craftfleet.Run: training and its results, by CraftFleet's programs."""

from __future__ import annotations

import json
import os
import pathlib
import tempfile
from typing import TYPE_CHECKING, Any

import numpy as np

from craftfleet import _programs
from craftfleet.policy import Policy
from craftfleet.runs import Score, load_curves, load_weights, score

if TYPE_CHECKING:
  import pandas


class Run:
  """The folder of a run: `craftfleet.Run("runs/first")`. Each attribute reads it anew, also while the run is going on."""

  def __init__(self, folder: str | os.PathLike[str], evaluation: Score | None = None) -> None:
    self.folder: pathlib.Path = _programs.absolute(folder)
    self.evaluation: Score | None = evaluation  # what evaluate() found
    if not (self.folder / "config.txt").exists():
      raise FileNotFoundError(f"{self.folder}: no run, want a folder with config.txt")

  def __repr__(self) -> str:
    return f"craftfleet.Run({str(self.folder)!r})"

  @property
  def score(self) -> float:
    """Crafter's score, 0..100: of the evaluation if this is what evaluate() returned, else of all training episodes."""
    return (self.evaluation or score(self.folder)).score

  @property
  def curves(self) -> pandas.DataFrame:
    """What TensorBoard shows, as load_curves()."""
    return load_curves(self.folder)

  @property
  def weights(self) -> dict[str, np.ndarray]:
    """The weights of the newest checkpoint, as load_weights()."""
    return load_weights(self.folder)

  def policy(self, *, deterministic: bool = False, seed: int = 0) -> Policy:
    """The policy of the newest checkpoint, which chooses actions for observations."""
    return Policy(self.folder, deterministic=deterministic, seed=seed)


def train(
    *, logdir: str | os.PathLike[str], agent: str | None = None, env: str | None = None, steps: int | None = None,
    seed: int | None = None, lanes: int | None = None, resume: bool = False, progress: bool = True, **flags: Any) -> Run:
  """Trains an agent into the folder `logdir` and returns the run. Other flags of `craftfleet train --help` are taken too.

  Ctrl-C stops it with a checkpoint within seconds and raises KeyboardInterrupt; the same call with resume=True continues. ValueError:
  the program refused an argument; RuntimeError: it failed later; both carry its message. FileNotFoundError and ModuleNotFoundError:
  the programs or torch are missing.
  """
  logdir = _programs.absolute(logdir)
  _programs.run("train", progress, agent=agent, env=env, steps=steps, seed=seed, lanes=lanes, resume=resume, logdir=logdir, **flags)
  return Run(logdir)


def evaluate(
    run: Run | str | os.PathLike[str], *, episodes: int | None = None, env: str | None = None, seed: int | None = None,
    deterministic: bool = False, out: str | os.PathLike[str] | None = None, progress: bool = True, **flags: Any) -> Run:
  """Plays whole episodes with the newest checkpoint of a run. Returns the run with the result as its `evaluation`.

  Other flags of `craftfleet eval --help` are taken too, such as `video="videos"`. Stops and fails as train().
  """
  if "checkpoint" in flags:
    raise ValueError("checkpoint: evaluate() plays the newest of `run`, which may also be the folder of a checkpoint")
  if "protocol" in flags:
    raise ValueError("protocol: it may have several results, and evaluate() returns one; run `craftfleet eval --protocol=final`")
  run = run if isinstance(run, Run) else Run(run)
  with tempfile.TemporaryDirectory(prefix="craftfleet-") as temporary:
    file = pathlib.Path(temporary) / "result.json" if out is None else _programs.absolute(out)
    _programs.run(
        "eval", progress, checkpoint=run.folder, episodes=episodes, env=env, seed=seed, deterministic=deterministic, out=file, **flags)
    result = json.loads(file.read_text(encoding="utf-8"))
  return Run(
      run.folder,
      Score(
          score=result["score"], success_rates=result["success_percentages"], reward=result["reward"], length=result["length"],
          episodes=result["episodes"]))
