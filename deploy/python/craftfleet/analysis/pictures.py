"""The report's pictures."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np

from . import charts
from .logs import ACHIEVEMENTS
from .figures import Figures
from .results import MEASURES, SCORES, CellResult, ExperimentResult, SpreadCurve, curve_end, spread_of_curves
from .statistics import Spread, seeds_text
from .tables import PAPER, PAPER_SEEDS

_CELLS_OF_CHART = len(charts.COLORS)


@dataclasses.dataclass(frozen=True)
class Picture:
  name: str  # of its file: "table1-curves.png"
  title: str  # its alternative text
  content: bytes


def chart_parts(experiment: ExperimentResult) -> list[list[CellResult]]:
  """Cells with runs, in charts of at most seven.

  Experiments that vary one axis at a time have a chart for each axis (none for an axis with only one such cell, which is in the
  charts of other axes, too); those that vary two have one for each choice of the first.
  """
  each = experiment.varies_one_of_several
  parts: list[list[CellResult]] = []
  last = None
  for cell in experiment.cells:
    if not cell.group:
      continue
    place = cell.axes[0] if each else cell.choices[0] if experiment.has_two_axes else 0
    if not parts or place != last or len(parts[-1]) == _CELLS_OF_CHART:
      parts.append([])
    last = place
    parts[-1].append(cell)
  return [part for part in parts if len(part) > 1] if each else parts


def _series_label(experiment: ExperimentResult, cell: CellResult) -> str:
  """Without the choice that the title of the chart names."""
  if experiment.has_two_axes:
    label = experiment.axes[1].choices[cell.choices[1]].label
  else:
    label = experiment.axes[cell.axes[0]].choices[cell.choices[0]].label if experiment.varies_one_of_several else cell.label
  return charts.legend_name(label)


def _with_seeds(experiment: ExperimentResult, cell: CellResult) -> str:
  return f"{_series_label(experiment, cell)} (n={len(cell.group.complete)})"


def _draw_curve(axes: Sequence, label: str, color: str, curve: SpreadCurve, dashed: bool = False) -> None:
  """Mean of the seeds, with a standard deviation to each side."""
  for panel, spreads in zip(axes, (curve.score, curve.reward)):
    mean = np.array([spread.mean for spread in spreads])
    panel.plot(curve.steps, mean, "--" if dashed else "-", color=color, linewidth=1 if dashed else 1.5, label=label)
    if spreads[0].deviation is not None:
      deviation = np.array([spread.deviation for spread in spreads])
      panel.fill_between(curve.steps, np.maximum(mean - deviation, 0), mean + deviation, color=color, alpha=0.18, linewidth=0)


def _part_title(experiment: ExperimentResult, part: list[CellResult]) -> str:
  if experiment.has_two_axes:
    return f"{experiment.axes[0].choices[part[0].choices[0]].label}: "
  return f"{experiment.axes[part[0].axes[0]].name}: " if experiment.varies_one_of_several else ""


def _curves_of(experiment: ExperimentResult, cell: CellResult) -> list[tuple[str, SpreadCurve, bool]]:
  """Label, curve and whether it is of an unfinished run; only those with ten episodes."""
  curves = []
  if cell.group.complete:
    curves.append((_with_seeds(experiment, cell), spread_of_curves(cell.group.complete, curve_end(cell.group.first)), False))
  curves += [(f"{_series_label(experiment, cell)}, seed {run.seed}, unfinished", spread_of_curves([run], run.steps), True)
             for run in cell.group.incomplete]
  return [curve for curve in curves if curve[1].steps]


def curves_picture(experiment: ExperimentResult) -> Picture | None:
  """Learning curves, a row of charts for each part.   None: no run has ten episodes."""
  drawn = [(part, [(color, curve) for color, cell in zip(charts.COLORS, part) for curve in _curves_of(experiment, cell)])
           for part in chart_parts(experiment)]
  drawn = [(part, curves) for part, curves in drawn if curves]
  if not drawn:
    return None
  figure, axes = charts.new_figure(9, (3.2 if len(drawn) == 1 else 2.2) * len(drawn), len(drawn), 2)
  for row, (part, curves) in zip(axes, drawn):
    for color, (label, curve, unfinished) in curves:
      _draw_curve(row, label, color, curve, unfinished)
    title = _part_title(experiment, part)
    charts.finish_curve_axes(row[0], f"{title}Crafter score", "over all training episodes so far")
    charts.finish_curve_axes(row[1], f"{title}reward", "mean of the last 100 episodes")
    row[1].legend(loc="lower right")
  return Picture(f"{experiment.name}-curves.png", f"Learning curves: {experiment.title}", charts.png(figure))


def achievements_picture(experiment: ExperimentResult) -> Picture | None:
  """Success rates, a chart for each part.   None: no complete run has episodes."""
  parts = [[cell for cell in part if cell.over("train").n] for part in chart_parts(experiment)]
  parts = [part for part in parts if part]
  if not parts:
    return None
  columns = 1 if len(parts) == 1 else 2
  rows = -(-len(parts) // columns)
  figure, axes = charts.new_figure(9, 3.2 * rows, rows, columns, sharex=True)
  for panel, part in itertools.zip_longest(axes.flat, parts):
    if part is None:
      panel.set_visible(False)
      continue
    width = 0.8 / len(part)
    for number, cell in enumerate(part):
      spreads = cell.group.success()
      place = np.arange(len(ACHIEVEMENTS)) + (number - (len(part) - 1) / 2) * width
      panel.bar(place, [spread.mean for spread in spreads], width, color=charts.COLORS[number], label=_with_seeds(experiment, cell),
                yerr=[spread.deviation or 0 for spread in spreads], error_kw={"elinewidth": 0.6})
    panel.set(title=f"{_part_title(experiment, part)}% of training episodes", ylim=(0, 125), yticks=range(0, 101, 20))
    panel.set_xticks(np.arange(len(ACHIEVEMENTS)), [name.replace("_", " ") for name in ACHIEVEMENTS], rotation=90)
    panel.tick_params(labelbottom=True)
    panel.legend(loc="upper right")
  return Picture(f"{experiment.name}-achievements.png", f"Success rates: {experiment.title}", charts.png(figure))


def scores_picture(experiment: ExperimentResult, paper: Figures) -> Picture | None:
  """Bars of our scores in training and evaluation, and the paper's; cells with neither are left out.   None: all are."""
  series = [("paper, training", "train", charts.PAPER_COLOR), ("paper, evaluation", "eval", "#8a8a8a")]
  cells = [cell for cell in experiment.cells if cell.over("train").n or any(
      paper.find(experiment.name, cell.name, measure) for _, measure, _ in series)]
  bars = []  # label, colour, values, deviations
  for label, measure, color in series:
    figures = [paper.find(experiment.name, cell.name, measure) for cell in cells]
    if any(figures):
      label += f" (n={PAPER_SEEDS})" if all(figure.source == PAPER for figure in figures if figure) else ""
      bars.append((label, color, [figure.mean if figure else np.nan for figure in figures],
                   [figure.deviation or 0 if figure else 0 for figure in figures]))
  for measure, color in zip(SCORES, charts.COLORS):
    spreads = [cell.over(measure) for cell in cells]
    if any(spread.n for spread in spreads):
      bars.append((f"ours, {MEASURES[measure].label}", color, [spread.mean for spread in spreads],
                   [spread.deviation or 0 for spread in spreads]))
  if not bars:
    return None
  figure, axes = charts.new_figure(8, 1 + 0.14 * len(cells) * (len(bars) + 1))
  height = 0.8 / len(bars)
  for number, (label, color, values, deviations) in enumerate(bars):
    place = np.arange(len(cells)) + (number - (len(bars) - 1) / 2) * height
    axes[0, 0].barh(place, np.nan_to_num(values), height, color=color, label=label, xerr=deviations, error_kw={"elinewidth": 0.8})
    for y, value, deviation in zip(place, values, deviations):
      if not np.isnan(value):
        axes[0, 0].text(value + deviation, y, f" {value:.1f}", va="center", fontsize=6)
  names = [cell.label + (f" (n={cell.over('train').n})" if cell.over("train").n else " (no run)") for cell in cells]
  axes[0, 0].set_yticks(np.arange(len(cells)), names)
  axes[0, 0].invert_yaxis()
  axes[0, 0].set(title=experiment.title, xlabel="Crafter score")
  axes[0, 0].margins(x=0.08)
  axes[0, 0].legend(loc="upper left", bbox_to_anchor=(1, 1))
  return Picture(f"{experiment.name}-scores.png", f"Scores: {experiment.title}", charts.png(figure))


@dataclasses.dataclass(frozen=True)
class _Map:
  title: str
  rows: list[str]
  columns: list[str]
  values: np.ndarray  # nan: none
  seeds: np.ndarray  # 0: the paper's


def _map(experiment: ExperimentResult, title: str, axes: tuple[int, int], value) -> _Map:
  """`value` gives mean and number of seeds of a cell."""
  pairs = [[value(cell) for cell in line] for line in experiment.matrix(*axes)]
  rows, columns = ([choice.label for choice in experiment.axes[axis].choices] for axis in axes)
  return _Map(title, rows, columns, np.array([[mean for mean, _ in line] for line in pairs], float),
              np.array([[n for _, n in line] for line in pairs]))


def _maps(experiment: ExperimentResult, paper: Figures) -> list[_Map]:
  """Our maps and the paper's, measure by measure; of pairs, the training scores of every two axes. Those with runs only."""
  def ours(measure):
    return lambda cell: (cell.over(measure).mean, cell.over(measure).n)
  def theirs(measure):
    def value(cell):
      figure = paper.find(experiment.name, cell.name, measure)
      return (figure.mean if figure else np.nan, 0)
    return value
  if experiment.combine == "pairs":
    maps = []
    for a, b in itertools.combinations(range(len(experiment.axes)), 2):
      title = f"{experiment.axes[a].name} (down), {experiment.axes[b].name} (across)"
      maps.append(_map(experiment, title, (a, b), ours("train")))
    return [one for one in maps if len(np.unique(one.values[~np.isnan(one.values)])) > 1]  # one number needs no map
  maps = []
  for measure, published in (("train", "train"), ("eval", "eval"), ("eval_argmax", None)):
    maps.append(_map(experiment, f"Ours, {MEASURES[measure].label}", (0, 1), ours(measure)))
    if published:
      maps.append(_map(experiment, f"Paper, {MEASURES[published].label.split(',')[0]}", (0, 1), theirs(published)))
  shown = [one for one in maps if not np.isnan(one.values).all()]
  return shown if any(one.seeds.any() for one in shown) else []


def heatmap_picture(experiment: ExperimentResult, paper: Figures) -> Picture | None:
  """Scores of two axes against each other, ours with n, and the paper's, on one scale.   None: there is no run."""
  maps = _maps(experiment, paper)
  if not maps:
    return None
  columns = min(2, len(maps))
  rows = -(-len(maps) // columns)
  height = sum(0.9 + 0.24 * len(one.rows) for one in maps[::columns])
  figure, axes = charts.new_figure(4.6 * columns, height, rows, columns)
  low = min(np.nanmin(one.values) for one in maps)
  high = max(np.nanmax(one.values) for one in maps)
  image = None
  for panel, one in itertools.zip_longest(axes.flat, maps):
    if one is None:
      panel.set_visible(False)
      continue
    image = panel.imshow(one.values, vmin=low, vmax=high, cmap="viridis", aspect="auto")
    for (row, column), value in np.ndenumerate(one.values):
      if not np.isnan(value):
        n = int(one.seeds[row, column])
        bright = high > low and (value - low) / (high - low) > 0.6
        panel.text(column, row, f"{value:.1f}" + (f" ({n})" if n else ""), ha="center", va="center", fontsize=6.5,
                   color="black" if bright else "white")
    panel.set_xticks(range(len(one.columns)), [label.split(",")[0] for label in one.columns], rotation=25, ha="right")
    panel.set_yticks(range(len(one.rows)), one.rows)
    panel.set_title(one.title + (", with (n)" if one.seeds.any() else " (n=10)"))
    panel.grid(False)
  figure.colorbar(image, ax=axes, shrink=0.6, label="Crafter score")
  return Picture(f"{experiment.name}-heatmap.png", f"Heatmap: {experiment.title}", charts.png(figure))


def evaluation_picture(experiment: ExperimentResult, paper: Figures) -> Picture | None:
  """Evaluation scores beside the paper's, where evaluation is in another environment than training.   None: there are none."""
  series, names = [], {}  # cells of a choice of the second axis with the paper's figures; the labels of their rows
  for number, choice in enumerate(experiment.axes[1].choices):
    cells = [line[number] for line in experiment.matrix(0, 1)]
    compared = [(cell, paper.find(experiment.name, cell.name, "eval")) for cell in cells
                if cell.over("eval").n and "eval" in cell.group.first.settings]
    compared = [(cell, figure) for cell, figure in compared if figure]
    names |= {cell.choices[0]: experiment.axes[0].choices[cell.choices[0]].label for cell, _ in compared}
    if compared:
      series.append((choice.label.split(",")[0], compared))
  if not series:
    return None
  rows = sorted(names)
  figure, axes = charts.new_figure(4.6, 3)
  for number, (label, compared) in enumerate(series):
    place = np.array([rows.index(cell.choices[0]) for cell, _ in compared]) + 0.4 * ((number + 0.5) / len(series) - 0.5)
    n = seeds_text([cell.over("eval") for cell, _ in compared])
    color = charts.COLORS[number % len(charts.COLORS)]
    published = [figure for _, figure in compared]
    points = [(f"ours, sampled ({n})", "o", color, [cell.over("eval") for cell, _ in compared]),
              (f"ours, argmax ({n})", "o", "white", [cell.over("eval_argmax") for cell, _ in compared]),
              (f"paper (n={PAPER_SEEDS})", "_", color, [Spread(PAPER_SEEDS, one.mean, one.deviation) for one in published])]
    for name, marker, fill, spreads in points:
      axes[0, 0].errorbar(place, [spread.mean for spread in spreads], [spread.deviation or 0 for spread in spreads], fmt=marker,
                          color=color, markerfacecolor=fill, markersize=4 if marker == "o" else 7, elinewidth=0.8,
                          label=charts.legend_name(f"{label}, {name}"))
  axes[0, 0].set_xticks(range(len(rows)), [names[row] for row in rows], rotation=30, ha="right")
  axes[0, 0].set(title=f"{experiment.title.split(':')[0]}, evaluation", ylabel="Crafter score")
  axes[0, 0].margins(y=0.08)
  axes[0, 0].set_ylim(bottom=0)
  axes[0, 0].legend(loc="lower left", fontsize=6)
  return Picture(f"{experiment.name}-evaluation.png", f"Evaluation: {experiment.title}", charts.png(figure))


def experiment_pictures(experiment: ExperimentResult, paper: Figures) -> list[Picture]:
  """All pictures of an experiment with runs."""
  pictures: list[Picture | None] = []
  complete = {cell.identity for cell in experiment.cells if cell.is_complete}
  least = 2 if experiment.varies_one_of_several else 1  # the base of all axes alone needs no chart
  if experiment.has_two_axes:
    pictures.append(heatmap_picture(experiment, paper))
    if experiment.combine != "pairs":
      pictures.append(evaluation_picture(experiment, paper))
  elif len(complete) >= least and not experiment.milestones:
    pictures.append(scores_picture(experiment, paper))
  if experiment.combine != "pairs":
    pictures += [curves_picture(experiment), achievements_picture(experiment)]
  return [picture for picture in pictures if picture]
