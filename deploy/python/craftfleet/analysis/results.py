"""Runs in groups of one configuration, and groups in the cells of experiments."""

from __future__ import annotations

import dataclasses
import functools
import os
import re
from collections import Counter
from collections.abc import Callable, Sequence

import numpy as np

from . import statistics
from .logs import FEWEST_EPISODES, Episodes
from .experiments import Axis, Choice, Experiment
from .runs import SUFFIX, Run
from .statistics import Spread, spread_of

OWN_RUNS = "other"  # the experiment of runs that fit no cell, and the name of its CSV file
CURVE_POINTS = 200


@dataclasses.dataclass(frozen=True)
class Measure:
  """A number that the report shows of each run."""

  name: str  # in CSV files
  label: str  # in tables
  log: str  # the episodes that it is about
  value: Callable[[Episodes], float]

  @property
  def is_score(self) -> bool:
    return self.name in ("train", "eval", "eval_argmax", "final", "final_argmax")

  def of(self, run: Run) -> float | None:
    """None: the run has no such episodes."""
    episodes = run.logs[self.log]
    return float(self.value(episodes)) if len(episodes) else None


MEASURES = {measure.name: measure for measure in (
    Measure("train", "training score", "stats", lambda episodes: episodes.score),
    Measure("eval", "evaluation score, sampled", "eval_sampled", lambda episodes: episodes.score),
    Measure("eval_argmax", "evaluation score, argmax", "eval_argmax", lambda episodes: episodes.score),
    Measure("final", "final score", "final_sampled", lambda episodes: episodes.score),
    Measure("final_argmax", "final score, argmax", "final_argmax", lambda episodes: episodes.score),
    Measure("reward", "reward", "stats", lambda episodes: episodes.reward),
    Measure("reward_last100", "reward, last 100", "stats", lambda episodes: episodes.recent_reward),
    Measure("unlocked", "achievements unlocked", "stats", lambda episodes: episodes.unlocked),
    Measure("episodes", "episodes", "stats", len),
)}
SCORES = ("train", "eval", "eval_argmax")  # of these, the report shows all three wherever it compares


class Group:
  """Runs of one configuration with different seeds."""

  def __init__(self):
    self.complete: list[Run] = []  # by seed, each once
    self.incomplete: list[Run] = []  # not averaged
    self.repeated: list[Run] = []  # further runs of the same seed; not counted

  @property
  def first(self) -> Run:
    return (self.complete or self.incomplete)[0]

  @property
  def folders(self) -> list[str]:
    return sorted(run.folder for run in self.complete + self.incomplete)

  def over(self, measure: str) -> Spread:
    values = [MEASURES[measure].of(run) for run in self.complete]
    return spread_of([value for value in values if value is not None])

  @functools.cache  # pylint: disable=method-cache-max-size-none  # a few for each group of a report
  def interval(self, name: str) -> tuple[float, float] | None:
    """95% interval of a measure's mean over the complete runs; None: no such episodes, or of a reward with fewer than three seeds."""
    measure = MEASURES[name]
    runs = [run for run in self.complete if len(run.logs[measure.log])]
    if len(runs) >= statistics.FEWEST_SEEDS:
      return statistics.interval_over_seeds([measure.of(run) for run in runs])
    if not runs or not measure.is_score:
      return None
    return statistics.interval_over_episodes([run.logs[measure.log] for run in runs])

  def success(self) -> list[Spread]:
    """Of each achievement in training episodes of the complete runs, percent."""
    rates = [run.training.success for run in self.complete if len(run.training)]
    return [spread_of(column) for column in np.transpose(rates)] if rates else [Spread()] * 22

  def scores_at(self, measure: str, steps: int) -> Spread:
    """Scores at a milestone, over all runs that have reached it, incomplete ones too."""
    values = []
    for run in self.complete + self.incomplete:
      if run.steps < steps:
        continue
      if measure == "train":
        index = run.curve.index_at(steps)
        values += [float(run.curve.score[index])] if index >= 0 else []
      else:
        episodes = run.evaluation_at(MEASURES[measure].log, steps)
        values += [episodes.score] if len(episodes) else []
    return spread_of(values)


def group_runs(runs: Sequence[Run]) -> dict[str, Group]:
  """Groups by identity, sorted by it."""
  groups: dict[str, Group] = {}
  for complete in (True, False):
    for run in runs:
      if run.complete != complete:
        continue
      group = groups.setdefault(run.identity, Group())
      seeds = {other.seed for other in group.complete + group.incomplete}
      (group.repeated if run.seed in seeds else group.complete if complete else group.incomplete).append(run)
  for group in groups.values():
    group.complete.sort(key=lambda run: run.seed)
    group.incomplete.sort(key=lambda run: run.seed)
  return dict(sorted(groups.items()))


@dataclasses.dataclass
class SpreadCurve:
  """Learning curves of several runs as one."""

  steps: list[int] = dataclasses.field(default_factory=list)
  score: list[Spread] = dataclasses.field(default_factory=list)
  reward: list[Spread] = dataclasses.field(default_factory=list)


def curve_end(run: Run) -> int:
  return max(int(run.config["steps"]), int(run.config["ppo"]["rollout_steps"]))


def spread_of_curves(runs: Sequence[Run], steps: int) -> SpreadCurve:
  """200 points up to `steps`, from where every run has ten episodes. A run's value is that of its last episode so far."""
  curve = SpreadCurve()
  for number in range(1, CURVE_POINTS + 1):
    at = steps * number // CURVE_POINTS
    indices = [run.curve.index_at(at) for run in runs]
    if not runs or min(indices) < FEWEST_EPISODES - 1:
      continue
    curve.steps.append(at)
    curve.score.append(spread_of([run.curve.score[index] for run, index in zip(runs, indices)]))
    curve.reward.append(spread_of([run.curve.reward[index] for run, index in zip(runs, indices)]))
  return curve


# Cells.


@dataclasses.dataclass
class CellResult:
  name: str  # the cell's; of runs that fit no cell, their folder
  label: str  # for tables and charts
  axes: tuple[int, ...]
  choices: tuple[int, ...]
  group: Group | None  # None: no run
  identity: str

  @property
  def is_complete(self) -> bool:
    return self.group is not None and bool(self.group.complete)

  def over(self, measure: str) -> Spread:
    return self.group.over(measure) if self.group else Spread()


class ExperimentResult(Experiment):
  """An experiment whose cells are CellResults."""

  @property
  def has_runs(self) -> bool:
    return any(cell.group for cell in self.cells)

  @property
  def is_own(self) -> bool:
    return self.name == OWN_RUNS

  def matrix(self, row_axis: int, column_axis: int) -> list[list[CellResult]]:
    """The cells that vary exactly these two axes, row by row."""
    found = {cell.choices: cell for cell in self.cells if cell.axes == (row_axis, column_axis)}
    return [[found[row, column] for column in range(len(self.axes[column_axis].choices))]
            for row in range(len(self.axes[row_axis].choices))]


def _label(experiment: Experiment, cell) -> str:
  labels = [experiment.axes[axis].choices[choice].label for axis, choice in zip(cell.axes, cell.choices)]
  if not labels:
    return experiment.title
  return (f"{experiment.axes[cell.axes[0]].name} " if experiment.varies_one_of_several else "") + ", ".join(labels)


def match(experiments: Sequence[Experiment], groups: dict[str, Group]) -> list[ExperimentResult]:
  """A result for each experiment, after one of the runs that belong to no cell, if there are any."""
  results = []
  for experiment in experiments:
    cells = [CellResult(cell.name, _label(experiment, cell), cell.axes, cell.choices, groups.get(cell.identity), cell.identity)
             for cell in experiment.cells]
    results.append(ExperimentResult(experiment.name, experiment.title, experiment.combine, experiment.axes,
                                    experiment.milestones, cells))
  matched = {cell.identity for result in results for cell in result.cells}
  own = {identity: group for identity, group in groups.items() if identity not in matched}
  if own:
    names = sorted(zip(name_groups(list(own.values())), own.items()), key=lambda named: named[0][0])
    cells = [CellResult(folder, label, (0,), (number,), group, identity)
             for number, ((folder, label), (identity, group)) in enumerate(names)]
    axis = Axis("runs", [Choice(cell.name, cell.label, {}) for cell in cells])
    results.insert(0, ExperimentResult(OWN_RUNS, "Your own configurations", "each", [axis], [], cells))
  return results


def cell_names(experiments: Sequence[Experiment]) -> dict[str, list[str]]:
  """The cells of each identity."""
  names: dict[str, list[str]] = {}
  for experiment in experiments:
    for cell in experiment.cells:
      names.setdefault(cell.identity, []).append(f"{experiment.name}/{cell.name}")
  return names


# Names of runs that belong to no cell.


def short_names(paths: Sequence[str]) -> list[str]:
  """Names that distinguish `paths`: without the folders that all have in common, and without "stats.jsonl"."""
  parts = []
  for path in paths:
    own = [part for part in path.removesuffix(SUFFIX).split("/") if part]
    parts.append(own[:-1] if len(own) > 1 and own[-1] in ("stats.jsonl", "stats.jsonl.gz") else own)
  shared = 0
  while parts and all(len(own) > shared + 1 and own[shared] == parts[0][shared] for own in parts):
    shared += 1
  return ["/".join(own[shared:]) for own in parts]


def _name_folders(folders: list[str], others: list[str]) -> str:
  """A name for `folders` alone: their run's folder, the one that has them and none of `others`, or the first and how many more."""
  above = os.path.dirname(folders[0])
  is_one = len(folders) == 1 and not re.fullmatch(r"seed\d+", os.path.basename(folders[0]))
  if is_one or not above or any(f"{folder}/".startswith(f"{above}/") != (folder in folders) for folder in folders + others):
    return folders[0] + (f" and {len(folders) - 1} more" if len(folders) > 1 else "")
  return above


def _flat(settings: dict, prefix: str = "") -> dict[str, str]:
  """{"ppo": {"gamma": 0.95}} -> {"ppo.gamma": "0.95"}"""
  flat = {}
  for key, value in settings.items():
    if isinstance(value, dict):
      flat |= _flat(value, f"{prefix}{key}.")
    else:
      flat[prefix + key] = str(value).lower() if isinstance(value, bool) else str(value)
  return flat


def _setting_text(name: str, value: str) -> str:
  return f"env={value}" if name == "env.name" else f"{name.removeprefix('ppo.')}={value}"


_SHOWN_SETTINGS = 3


def name_groups(groups: Sequence[Group]) -> list[tuple[str, str]]:
  """A folder and a label for each group: "runs/wide", "wide (ppo_cnn, lanes=32)".

  The label has the settings that are neither the agent's defaults nor usual among the groups.
  """
  folders = [_name_folders(group.folders, [folder for other in groups if other is not group for folder in other.folders])
             for group in groups]
  settings = []
  for group in groups:
    settings.append(dict(sorted(_flat(group.first.settings).items())))
    if not group.first.built_in_textures:
      settings[-1]["textures"] = group.first.texture_digest
  counts = Counter(item for of_group in settings for item in of_group.items())
  labels = []
  for group, name, of_group in zip(groups, short_names(folders), settings):
    defaults = _flat(group.first.defaults)
    shown = [_setting_text(key, value) for key, value in sorted(of_group.items())
             if defaults.get(key) != value and (key == "textures" or 2 * counts[key, value] <= len(groups))]
    more = len(shown) - _SHOWN_SETTINGS
    shown = shown[:_SHOWN_SETTINGS] + ([f"{more} more"] if more > 0 else [])
    labels.append(f"{name} ({', '.join([group.first.agent, *shown])})")
  return list(zip(folders, labels))
