"""craftfleet curve: draws learning curves."""

from __future__ import annotations

import csv
import dataclasses
import math
import os
import sys
from collections.abc import Callable

from . import _cli
from ._cli import Flag, OutputFile, Refusal, read_text

PROGRAM = "craftfleet curve"
USAGE = """craftfleet curve RUN... draws the learning curves of runs and prints their last values. RUN is a run folder, its
stats.jsonl, gzipped or plain, or a result file (.npz). The picture shows the mean reward of the last 100 episodes on the
left, and the Crafter score over all training episodes so far on the right, against the environment steps of finished
episodes.

  craftfleet curve --out=curve.png runs/first runs/second
  craftfleet curve --out=curve.png --reference=paper.csv deploy/experiments/results/ppo_cnn_300k/seed*.npz"""
FLAGS = [
    Flag("out", "string", "", "PNG file for the picture; -: standard output [none: only print the table]"),
    Flag("reference", "list", [], "CSV files with runs of other programs to compare with, joined by commas\n"
         "columns: episodes, steps, ep_rew_mean100 and crafter_score_cum"),
]
_MOST = 1e12  # of a number in a reference
REFERENCE_COLUMNS = ("episodes", "steps", "ep_rew_mean100", "crafter_score_cum")


@dataclasses.dataclass
class NamedCurve:
  name: str
  curve: object  # logs.Curve, not empty


def read_reference(path: str):
  """The curve in a CSV file.   Refusal: a column is missing, or a value is no number; names line and column."""
  import numpy as np  # pylint: disable=import-outside-toplevel
  from .logs import Curve  # pylint: disable=import-outside-toplevel
  lines = csv.DictReader(read_text(path).splitlines(), skipinitialspace=True)
  for column in REFERENCE_COLUMNS:
    if column not in (lines.fieldnames or ()):
      raise Refusal(f'{path}:1: no column "{column}"')
  rows = []
  for line in lines:
    for column in REFERENCE_COLUMNS:
      try:
        rows.append(float(line[column] or ""))
      except ValueError:
        rows.append(math.nan)
      if not abs(rows[-1]) <= _MOST:
        raise Refusal(f'{path}:{lines.line_num}: {column} is "{line[column] or ""}", want a number')
  if not rows:
    raise Refusal(f"{path}: no line after the column names")
  episodes, steps, reward, score = np.array(rows).reshape(-1, len(REFERENCE_COLUMNS)).T
  return Curve(episodes.astype(np.int64), steps.astype(np.int64), reward, score)


def _read_all(paths: list[str], read: Callable) -> list[NamedCurve]:
  """Those that can be read; the others are named in warnings.   Refusal: the first error if none can."""
  from .results import short_names  # pylint: disable=import-outside-toplevel
  curves, errors = [], []
  for path, name in zip(paths, short_names(paths)):
    try:
      curves.append(NamedCurve(name, read(path)))
    except Refusal as error:
      errors.append(error)
  if errors and not curves:
    raise errors[0]
  for error in errors:
    _cli.warn(f"left out: {error}")
  return curves


def _longest(runs: list[NamedCurve]) -> int:
  return max(int(run.curve.steps[-1]) for run in runs)


def _last_before(curve, steps: int) -> int:
  """The last point at `steps` or before; at least the first."""
  return max(curve.index_at(steps), 0)


def table(runs: list[NamedCurve], references: list[NamedCurve]) -> str:
  """A line per curve: its last values; those of references are at the end of the longest run."""
  width = max(3, *(len(one.name) for one in runs + references))
  text = f"{'run':{width}}  {'episodes':>8}  {'steps':>9}  {'reward, last 100':>16}  {'score':>5}\n"
  ends = [(run, len(run.curve) - 1) for run in runs] + [(one, _last_before(one.curve, _longest(runs))) for one in references]
  for one, at in ends:
    curve = one.curve
    text += f"{one.name:{width}}  {curve.episodes[at]:8d}  {curve.steps[at]:9d}  {curve.reward[at]:16.2f}  {curve.score[at]:5.2f}\n"
  return text


def drawn_points(curve, steps: int | None = None) -> slice:
  """The points that are drawn: from ten episodes on, if there are so many, up to `steps`."""
  from .logs import FEWEST_EPISODES  # pylint: disable=import-outside-toplevel
  end = len(curve) if steps is None else _last_before(curve, steps) + 1
  begin = int(curve.episodes.searchsorted(FEWEST_EPISODES))
  return slice(min(begin, end - 1), end)


def draw(runs: list[NamedCurve], references: list[NamedCurve]) -> bytes:
  """The picture, as PNG; references are dashed grey lines beneath the runs and end with the longest run."""
  from . import charts  # pylint: disable=import-outside-toplevel
  figure, axes = charts.new_figure(10, 4, 1, 2)
  greys = [("#5a5a5a", (0, (6, 3))), ("#969696", (0, (6, 3))), ("#5a5a5a", (0, (2, 2))), ("#969696", (0, (2, 2)))]
  styles = [(reference, _longest(runs), *greys[number % len(greys)], 1.0) for number, reference in enumerate(references)]
  styles += [(run, None, charts.COLORS[number % len(charts.COLORS)], "-", 1.3) for number, run in enumerate(runs)]
  for one, steps, color, line, width in styles:
    points = drawn_points(one.curve, steps)
    marker = "." if points.stop - points.start == 1 else ""  # a line through one point cannot be seen
    for panel, values in zip(axes[0], (one.curve.reward, one.curve.score)):
      panel.plot(one.curve.steps[points], values[points], linestyle=line, color=color, linewidth=width, marker=marker,
                 label=charts.legend_name(one.name))
  charts.finish_curve_axes(axes[0, 0], "Reward", "mean reward of the last 100 episodes")
  charts.finish_curve_axes(axes[0, 1], "Crafter score", "score over all episodes so far")
  axes[0, 1].legend(loc="lower right")
  return charts.png(figure)


def _run(flags, paths: list[str]) -> int:
  from .runs import read_curve  # pylint: disable=import-outside-toplevel
  if not paths:
    raise Refusal("name at least one run folder; see --help")
  if os.path.splitext(flags.out)[1].lower() not in ("", ".png"):
    raise Refusal(f"--out={flags.out}, want a file that ends in .png")
  out = OutputFile("--out", flags.out) if flags.out else None
  runs = _read_all(paths, read_curve)
  references = _read_all(flags.reference, read_reference)
  print(table(runs, references), end="", file=sys.stderr if out and out.is_standard_output else sys.stdout)
  if out:
    out.write(draw(runs, references))
  return 0


def main(arguments: list[str]) -> int:
  return _cli.run(PROGRAM, USAGE, FLAGS, arguments, _run)
