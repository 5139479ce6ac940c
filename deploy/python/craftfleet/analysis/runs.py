"""Runs: their configuration, episodes and progress, from run folders or from result files.

A result file holds a run without its weights: NAME.npz, a NumPy archive compressed with LZMA, with the format's version, the
texts of config.txt and run.json, the run's progress (steps, and whether it is complete), and each log as lengths, rewards in
tenths and counts of achievements. It loses nothing that the logs have.
"""

from __future__ import annotations

import dataclasses
import functools
import io
import json
import math
import os
import pathlib
import re
import warnings
import zipfile
import zlib
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

try:
  from lzma import LZMAError
except ImportError:  # a Python without it can read no results, but play
  LZMAError = RuntimeError

from . import programs
from ._cli import Refusal, read_text, reason, replace_file
from .logs import ACHIEVEMENTS, NO_EPISODES, Curve, Episodes, find_log, read_log

if TYPE_CHECKING:
  import pandas

LOGS = ("stats", "eval_argmax", "eval_sampled", "final_argmax", "final_sampled")
SUFFIX = ".npz"
_VERSION = 1
# What NumPy and zipfile raise; RuntimeError: an entry that seems to be encrypted, or of a method that they don't have.
_DAMAGED = (OSError, ValueError, KeyError, EOFError, RuntimeError, LZMAError, zlib.error, zipfile.BadZipFile)
_FIRST_ENTRY = "craftfleet_run.npy"  # its name is in the first bytes, too


@dataclasses.dataclass(eq=False)  # compared by identity, as pandas wants it
class Run:
  """A run; `folder` is that of its files, or the path of its result file without .npz."""

  folder: str
  config: dict  # complete, as config.proto names the fields
  identity: str  # equal for runs that differ in nothing but their seed
  settings: dict  # that may distinguish it from others, without the agent
  defaults: dict  # the agent's, of these
  texture_digest: str
  built_in_textures: bool
  steps_to_train: int  # in whole iterations
  logs: dict[str, Episodes]
  steps: int = 0  # done so far
  complete: bool = False

  @property
  def training(self) -> Episodes:
    return self.logs["stats"]

  @property
  def seed(self) -> int:
    return int(self.config.get("seed", 0))

  @property
  def agent(self) -> str:
    return self.config["agent"]

  @property
  def env(self) -> str:
    return self.config["env"]["name"]

  @property
  def eval_env(self) -> str:
    return self.config["eval"].get("env", "")

  @functools.cached_property
  def curve(self) -> Curve:
    return self.training.curve()

  def evaluation_at(self, log: str, steps: int) -> Episodes:
    """The episodes of eval_sampled or eval_argmax up to `steps` of training."""
    settings = self.config["eval"]
    every, rollout = int(settings.get("every_steps", 0)), int(self.config["ppo"]["rollout_steps"])
    due = steps // every if every else 0
    begun = min(due, -(-due * every // rollout))  # at most one in each iteration
    return self.logs[log].first(begun * int(settings.get("episodes", 0)))

  def steps_text(self) -> str:
    return f"{self.steps:,} of {self.steps_to_train:,}"


@dataclasses.dataclass
class _Files:
  """What is read of a run before its configuration is understood."""

  folder: str
  config: str
  run_json: str | None
  logs: dict[str, Episodes]
  is_folder: bool
  progress: tuple[int, bool] | None = None  # steps, complete: of a result file that has them

  @property
  def config_path(self) -> str:
    return os.path.join(self.folder, "config.txt") if self.is_folder else self.folder + SUFFIX

  def texture_digest(self) -> str:
    if self.run_json is None:
      return ""
    try:
      return str(json.loads(self.run_json)["texture_digest"])
    except (ValueError, KeyError, TypeError):
      path = os.path.join(self.folder, "run.json") if self.is_folder else self.folder + SUFFIX
      raise Refusal(f'{path}: no "texture_digest", want the digest of the textures') from None


def _read_folder(folder: str, is_final: bool = False) -> _Files:
  config = read_text(os.path.join(folder, "config.txt"))
  run_json = os.path.join(folder, "run.json")
  run_text = read_text(run_json) if os.path.exists(run_json) else None
  if not find_log(folder, "stats.jsonl"):
    raise Refusal(f"{folder}: not a run folder: it has no stats.jsonl")
  paths = {log: find_log(folder, f"{log}.jsonl") for log in LOGS}
  return _Files(folder, config, run_text, {log: read_log(path, is_final) if path else NO_EPISODES for log, path in paths.items()}, True)


def _read_result(path: str) -> _Files:
  try:
    with np.load(path) as arrays:
      if "craftfleet_run" not in arrays or int(arrays["craftfleet_run"]) != _VERSION:
        raise Refusal(f"{path}: not a result file of version {_VERSION}")
      logs = {log: NO_EPISODES for log in LOGS}
      for log in LOGS:
        if f"{log}_length" in arrays:
          logs[log] = Episodes(arrays[f"{log}_length"].astype(np.int64), arrays[f"{log}_reward"].astype(np.int64),
                               arrays[f"{log}_achievements"].T.astype(np.int64))
      texts = {name: arrays[name].tobytes().decode() if name in arrays else None for name in ("config", "run")}
      progress = (int(arrays["steps"]), bool(arrays["complete"])) if "steps" in arrays else None
  except _DAMAGED as error:
    raise Refusal(reason(error) if isinstance(error, OSError) and error.filename else f"{path}: {error}") from None
  return _Files(path.removesuffix(SUFFIX), texts["config"], texts["run"], logs, False, progress)


def _read_files(path: str) -> _Files:
  return _read_result(path) if path.endswith(SUFFIX) else _read_folder(path)


def _smallest(values: np.ndarray) -> np.ndarray:
  low, high = (int(values.min()), int(values.max())) if values.size else (0, 0)
  kinds = (np.uint8, np.int16, np.int32, np.int64)
  return values.astype(next(kind for kind in kinds if np.iinfo(kind).min <= low and high <= np.iinfo(kind).max))


def save_result(folder: str, path: str) -> None:
  """Writes the result file `path` of the run in `folder`.

  Refusal: the run cannot be read, or is not finished; OSError: `path` cannot be written.
  """
  files = _read_folder(folder, is_final=True)
  problems: list[str] = []
  understood = _understand([files], problems)
  if problems:
    raise Refusal(problems[0])
  run = understood[0]
  if not run.complete:
    raise Refusal(f"{folder}: unfinished after {run.steps_text()} steps, want all steps and the final evaluation")
  arrays = {"craftfleet_run": np.array(_VERSION), "config": np.frombuffer(files.config.encode(), np.uint8),
            "steps": np.array(run.steps), "complete": np.array(run.complete)}
  if files.run_json is not None:
    arrays["run"] = np.frombuffer(files.run_json.encode(), np.uint8)
  for log, episodes in files.logs.items():
    if len(episodes):
      arrays |= {f"{log}_length": _smallest(episodes.length), f"{log}_reward": _smallest(episodes.tenths),
                 f"{log}_achievements": _smallest(np.ascontiguousarray(episodes.counts.T))}
  content = io.BytesIO()
  with zipfile.ZipFile(content, "w", zipfile.ZIP_LZMA) as archive:
    for name, array in arrays.items():
      entry = io.BytesIO()
      np.lib.format.write_array(entry, array, allow_pickle=False)
      archive.writestr(zipfile.ZipInfo(f"{name}.npy"), entry.getvalue(), zipfile.ZIP_LZMA)  # the same bytes at any time
  replace_file(path, content.getvalue())


# Finding and understanding runs.


def newest_checkpoint(folder: str | os.PathLike[str]) -> pathlib.Path:
  """FileNotFoundError: the run has none."""
  checkpoints = pathlib.Path(folder) / "checkpoints"
  # Beside checkpoints there may be what people put there, such as iter-00000010.bak.
  found = [path for path in checkpoints.iterdir() if re.fullmatch(r"iter-[0-9]+", path.name)]
  if not found:
    raise FileNotFoundError(f"{checkpoints}: no checkpoint, want folders like iter-00000010")
  return max(found, key=lambda path: int(path.name[5:]))


def _is_run_folder(folder: str) -> bool:
  return os.path.exists(os.path.join(folder, "config.txt")) and bool(find_log(folder, "stats.jsonl"))


def _is_result(path: str) -> bool:
  """Also of one whose end is missing."""
  try:
    if not path.endswith(SUFFIX):
      return False
    with open(path, "rb") as file:
      if _FIRST_ENTRY.encode() in file.read(64):
        return True
    with zipfile.ZipFile(path) as archive:
      return _FIRST_ENTRY in archive.namelist()
  except _DAMAGED:
    return False


def _find_in(folder: str, found: set[str], unreadable: list[str]) -> None:
  """Adds the runs in and below `folder`. Links to folders are not entered."""
  for here, folders, files in os.walk(folder, onerror=lambda error: unreadable.append(reason(error))):
    folders.sort()
    paths = [here, *(os.path.join(here, name) for name in folders + files)]
    found.update(path for path in paths if _is_run_folder(path) or _is_result(path))


def _set_progress(run: Run, state: dict | None, recorded: tuple[int, bool] | None) -> None:
  if state is not None and state["begun"]:
    recorded = state["steps"], state["finished"]
  if recorded is not None:
    run.steps, run.complete = recorded
    return
  rollout = int(run.config["ppo"]["rollout_steps"])
  run.steps = -(-int(run.training.length.sum()) // rollout) * rollout  # its episodes end in that iteration
  wanted = int(run.config["eval"].get("final_episodes", 0))
  evaluated = wanted > 0 and all(len(run.logs[log]) >= wanted for log in ("final_argmax", "final_sampled"))
  run.complete = evaluated or run.steps >= int(run.config["steps"])
  if evaluated:
    run.steps = max(run.steps, run.steps_to_train)


def _understand(files: list[_Files], unreadable: list[str]) -> list[Run]:
  known = []
  for one in files:
    try:
      known.append((one, one.texture_digest()))
    except Refusal as error:
      unreadable.append(str(error))
  answers = programs.ask([{"config": one.config, "path": one.config_path, "textures": digest} for one, digest in known])
  runs = []
  recorded = {one.folder: one.progress for one in files}
  for (one, digest), answer in zip(known, answers):
    if "error" in answer:
      unreadable.append(answer["error"])
      continue
    runs.append(Run(one.folder, answer["config"], answer["identity"], answer["settings"], answer["defaults"], digest,
                    answer["built_in_textures"], answer["steps_to_train"], one.logs))
  folders = [run.folder for run in runs if os.path.isdir(os.path.join(run.folder, "checkpoints"))]
  steps = {run.folder: int(run.config["steps"]) for run in runs}
  states = dict(zip(folders, programs.ask([{"folder": folder, "steps": steps[folder]} for folder in folders])))
  good = []
  for run in runs:
    state = states.get(run.folder)
    if state is not None and "error" in state:
      unreadable.append(state["error"])
      continue
    _set_progress(run, state, recorded[run.folder])
    good.append(run)
  return good


def read_runs(folders: str | os.PathLike[str] | Sequence[str | os.PathLike[str]]) -> tuple[list[Run], list[str]]:
  """The runs in and below `folders`, each once, sorted by folder; and what could not be read, as sentences.

  A folder may also be a result file, without .npz as in Run.folder.   FileNotFoundError: a folder does not exist.
  """
  found: set[str] = set()
  unreadable: list[str] = []
  for given in [folders] if isinstance(folders, (str, os.PathLike)) else folders:
    folder = os.path.expanduser(given)
    folder = folder if folder.strip("/") == "" else folder.rstrip("/")
    in_it: set[str] = set()
    if os.path.isdir(folder):
      _find_in(folder, in_it, unreadable)
    if not in_it:  # a result file, beside which there may be a folder of its weights
      in_it.update(path for path in (folder, folder + SUFFIX) if _is_result(path))
    if not in_it and not os.path.isdir(folder):
      raise FileNotFoundError(f"{folder}: {'not a folder, and no result file' if os.path.exists(folder) else 'no such folder'}")
    found |= in_it
  files = []
  one_name = {os.path.realpath(path): path for path in sorted(found, reverse=True)}  # of those of the same run the first
  for path in sorted(one_name.values()):
    try:
      files.append(_read_files(path))
    except Refusal as error:
      unreadable.append(str(error))
  return _understand(files, unreadable), unreadable


def read_curve(path: str) -> Curve:
  """The learning curve of a run folder, a result file, with or without .npz, or a stats.jsonl.   Refusal: there is none."""
  result = path.rstrip("/") + SUFFIX
  if not os.path.isfile(path) and not find_log(path, "stats.jsonl") and _is_result(result):
    path = result
  if not os.path.exists(path):
    raise Refusal(f"{path}: no such run folder or file")
  if os.path.isdir(path):
    try:
      os.listdir(path)
    except OSError as error:
      raise Refusal(reason(error)) from None
    log = find_log(path, "stats.jsonl")
    if not log:
      raise Refusal(f"{path}: not a run folder: it has no stats.jsonl")
  else:
    log = path
  episodes = _read_result(log).logs["stats"] if log.endswith(SUFFIX) else read_log(log)
  if not len(episodes):
    raise Refusal(f"{log}: no episode has finished yet")
  return episodes.curve()


# For notebooks.

# Measures have the names of those in runs.csv of a report. Without a run there are these, too.
_MEASURES = ("train", "eval", "eval_argmax", "final", "final_argmax", "reward", "reward_last100", "unlocked")
_COLUMNS = ("folder", "agent", "env", "eval_env", "seed", "steps", "complete", *_MEASURES, "run")


def _found(paths: Sequence[str | os.PathLike[str] | Run]) -> tuple[list[Run], list[str]]:
  """Those that are runs, and further runs in and below the others; as read_runs.   FileNotFoundError: a folder does not exist."""
  runs, unreadable = read_runs([path for path in paths if not isinstance(path, Run)])
  given = list(dict.fromkeys(path for path in paths if isinstance(path, Run)))
  theirs = {os.path.realpath(run.folder) for run in given}
  return given + [run for run in runs if os.path.realpath(run.folder) not in theirs], unreadable


def load(*folders: str | os.PathLike[str] | Run | list) -> pandas.DataFrame:
  """A pandas.DataFrame with a row for each run in and below `folders`: its settings and scores; NaN: no such episodes.

  Folders may also be result files, runs (craftfleet.Run, analysis.Run), and lists of all these. The columns:
    folder, agent, env, seed: of the run. eval_env: the environment of its evaluations.
    steps: done so far. complete: whether it has done all.
    train: Crafter's score, 0..100, of all training episodes.
    eval, eval_argmax: of the evaluations during training, with sampled and with the most probable actions.
    final, final_argmax: of the evaluation at the end.
    reward, reward_last100: the mean of all training episodes, and of the last 100.
    unlocked: achievements that training episodes have unlocked, of 22.
    run: the analysis.Run, for episodes().

  A run that cannot be read is left out with a warning.   FileNotFoundError: a folder does not exist.
  """
  import pandas as pd  # pylint: disable=import-outside-toplevel
  from .results import MEASURES  # pylint: disable=import-outside-toplevel
  given = [one for folder in folders for one in (folder if isinstance(folder, list) else [folder])]
  runs, unreadable = _found(given)
  for problem in unreadable:
    warnings.warn(f"left out: {problem}", stacklevel=2)

  def value(run: Run, measure: str) -> float:
    of_run = MEASURES[measure].of(run)
    return math.nan if of_run is None else of_run

  table = [{
      "folder": run.folder, "agent": run.agent, "env": run.env, "eval_env": run.eval_env or run.env, "seed": run.seed,
      "steps": run.steps, "complete": run.complete, **{measure: value(run, measure) for measure in _MEASURES}, "run": run}
      for run in runs]
  return pd.DataFrame(table, columns=_COLUMNS)


def episodes(run: Run | str | os.PathLike[str], log: str = "stats") -> pandas.DataFrame:
  """A pandas.DataFrame with a row for each episode of a log of the run: its length, reward, and count of each achievement.

  Args:
    run: as of load(), the path of one run.
    log: "stats" (training), "eval_sampled" or "eval_argmax" (during training), "final_sampled" or "final_argmax" (at its end).

  ValueError: not one run that can be read, or no such log; FileNotFoundError: no such folder.
  """
  import pandas as pd  # pylint: disable=import-outside-toplevel
  if log not in LOGS:
    raise ValueError(f"log {log!r}, want one of {', '.join(LOGS)}")
  runs, unreadable = _found([run])
  if len(runs) != 1:
    raise ValueError(unreadable[0] if unreadable else f"{os.fspath(run)}: {len(runs)} runs, want one")
  of_run = runs[0].logs[log]
  table = pd.DataFrame(of_run.counts, columns=list(ACHIEVEMENTS))
  table.insert(0, "reward", of_run.tenths / 10)
  table.insert(0, "length", of_run.length)
  return table
