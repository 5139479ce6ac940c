"""craftfleet.train, craftfleet.evaluate and craftfleet.Run: training and its results, by CraftFleet's programs."""

from __future__ import annotations

import json
import os
import pathlib
import tempfile
from typing import TYPE_CHECKING, Any

import numpy as np

from craftfleet import _programs
from craftfleet.analysis import programs
from craftfleet.policy import Policy
from craftfleet.runs import Score, load_curves, load_weights, score

if TYPE_CHECKING:
  import pandas


class Run:
  """The folder of a run: `craftfleet.Run("runs/first")`. Each attribute reads it anew, also while the run is going on.

  It may be given where a path to a run is wanted. `config`, `env`, `steps` and `complete` need the programs of CraftFleet.
  """

  def __init__(self, folder: str | os.PathLike[str], evaluation: Score | None = None) -> None:
    self.folder: pathlib.Path = _programs.absolute(folder)
    self.evaluation: Score | None = evaluation  # what evaluate() found
    if not (self.folder / "config.txt").exists():
      raise FileNotFoundError(f"{self.folder}: no run, want a folder with config.txt")

  def __repr__(self) -> str:
    return f"craftfleet.Run({str(self.folder)!r})"

  def __fspath__(self) -> str:
    return str(self.folder)

  @property
  def config(self) -> dict[str, Any]:
    """The complete configuration, with the fields of config.txt; 64-bit integers are texts, as in analysis.Run."""
    path = self.folder / "config.txt"
    return _asked({"config": path.read_text(encoding="utf-8"), "path": str(path)})["config"]

  @property
  def env(self) -> str:
    """The environment that it is trained on: `craftfleet.Env(env=run.env)`."""
    return self.config["env"]["name"]

  @property
  def steps(self) -> int:
    """Steps of training that are done, those of the newest checkpoint."""
    return self._state()["steps"]

  @property
  def complete(self) -> bool:
    """Whether all its steps and its final evaluation are done."""
    return self._state()["finished"]

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

  def _state(self) -> dict[str, Any]:
    return _asked({"folder": str(self.folder), "steps": int(self.config["steps"])})


def _asked(question: dict[str, Any]) -> dict[str, Any]:
  (answer,) = programs.ask([question])
  if "error" in answer:
    raise ValueError(answer["error"])
  return answer


def train(
    *, logdir: str | os.PathLike[str], agent: str | None = None, env: str | None = None, steps: int | None = None,
    seed: int | None = None, lanes: int | None = None, resume: bool = False, progress: bool = True, **flags: Any) -> Run:
  """Trains an agent into the folder `logdir` and returns the run. Other flags of `craftfleet train --help` are taken too.

  Hyperparameters are fields of a configuration: `config=FILE`, such as an edited copy of another run's config.txt.

  Ctrl-C stops it with a checkpoint within seconds and raises KeyboardInterrupt; the same call with resume=True continues. ValueError:
  the program refused an argument; RuntimeError: it failed later, or SIGTERM stopped it; both carry its message. FileNotFoundError and
  ModuleNotFoundError: the programs or torch are missing.
  """
  logdir = _programs.absolute(logdir)
  try:
    _programs.run("train", progress, agent=agent, env=env, steps=steps, seed=seed, lanes=lanes, resume=resume, logdir=logdir, **flags)
  except ValueError as error:
    if not str(error).startswith("unknown flag"):
      raise
    raise ValueError(f"{error}; hyperparameters are fields of a configuration: config=FILE") from None
  run = Run(logdir)
  if not run.complete:
    raise RuntimeError(f"{logdir}: stopped after {run.steps:,} of {int(run.config['steps']):,} steps; resume=True continues it")
  return run


def evaluate(
    run: Run | str | os.PathLike[str], *, episodes: int | None = None, env: str | None = None, seed: int | None = None,
    deterministic: bool = False, out: str | os.PathLike[str] | None = None, progress: bool = True, **flags: Any) -> Run:
  """Plays whole episodes with the newest checkpoint of a run, or with the one that `run` is the folder of, such as
  "runs/first/checkpoints/iter-00000010". Returns the run with the result as its `evaluation`.

  Other flags of `craftfleet eval --help` are taken too, such as `video="videos"`. Stops and fails as train().
  """
  if "checkpoint" in flags:
    raise ValueError("checkpoint: evaluate() plays the newest of `run`, which may also be the folder of one of its checkpoints")
  if "protocol" in flags:
    raise ValueError("protocol: it may have several results, and evaluate() returns one; run `craftfleet eval --protocol=final`")
  checkpoint = pathlib.Path(os.path.normpath(_programs.absolute(run)))  # without "..", for its parents
  is_run = checkpoint.parent.name != "checkpoints" or (checkpoint / "config.txt").exists()
  folder = Run(checkpoint if is_run else checkpoint.parents[1]).folder
  with tempfile.TemporaryDirectory(prefix="craftfleet-") as temporary:
    file = pathlib.Path(temporary) / "result.json" if out is None else _programs.absolute(out)
    _programs.run(
        "eval", progress, checkpoint=checkpoint, episodes=episodes, env=env, seed=seed, deterministic=deterministic, out=file, **flags)
    result = json.loads(file.read_text(encoding="utf-8"))
  return Run(
      folder,
      Score(
          score=result["score"], success_rates=result["success_percentages"], reward=result["reward"], length=result["length"],
          episodes=result["episodes"]))
