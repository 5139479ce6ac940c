"""The tables of the report, in Markdown and as CSV."""

from __future__ import annotations

import csv
import io
import itertools
from collections.abc import Sequence

import numpy as np

from . import statistics
from .logs import ACHIEVEMENTS
from .figures import Figure, Figures, mean_text
from .results import MEASURES, SCORES, CellResult, ExperimentResult, Group, curve_end, spread_of_curves
from .runs import Run
from .statistics import Spread

PAPER = "Stanic et al. 2022"
PAPER_SEEDS = 10  # of each of its figures
_AVERAGE = "average"
_NAMED_CELLS = 8  # in the line above a folded table


def markdown(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
  lines = [header, ["---"] * len(header), *rows]
  return "".join(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in line)} |\n" for line in lines) + "\n"


def folded(summary: str, text: str) -> str:
  """A part that viewers show only when it is asked for."""
  return f"<details><summary>{summary}</summary>\n\n{text}</details>\n\n"


def _figure(paper: Figures, experiment: str, cell: str, measure: str, at: int = 0) -> Figure | None:
  """The published figure to compare with: the paper does not say how actions were chosen in evaluation."""
  return paper.find(experiment, cell, "eval" if measure == "eval_argmax" else measure, at)


def _over_paper(ours: str, figure: Figure | None) -> str:
  """Our value, with the paper's below it."""
  return ours if figure is None else f"{ours}<br>*paper {figure.text()}*"


def _seeds_at(group: Group) -> str:
  return ", ".join(f"seed {run.seed} at {run.steps_text()} steps" for run in group.incomplete)


def with_interval(group: Group, measure: str) -> str:
  """"10.3 ± 0.6 [9.8, 10.8]"."""
  interval = group.interval(measure)
  return group.over(measure).text() + (f" [{interval[0]:.1f}, {interval[1]:.1f}]" if interval else "")


def _ours(cell: CellResult, measure: str, with_seeds: bool) -> str:
  """The value, with the number of seeds if `with_seeds`; or why there is none."""
  if cell.group is None:
    return "no run"
  if not cell.is_complete:
    return f"unfinished: {_seeds_at(cell.group)}"
  spread = cell.over(measure)
  return with_interval(cell.group, measure) + (f" (n={spread.n})" if spread.n and with_seeds else "")


def _notes(cells: Sequence[CellResult]) -> str:
  """The list below a table of runs that are not in its means."""
  notes = "".join(f"- {cell.label}: not averaged because unfinished: {_seeds_at(cell.group)}\n" for cell in cells
                  if cell.is_complete and cell.group.incomplete)
  notes += "".join(f"- {cell.label}: {run.folder} not counted, seed {run.seed} is there already\n" for cell in cells
                   if cell.group for run in cell.group.repeated)
  return notes + ("\n" if notes else "")


def _row_table(experiment: ExperimentResult, first_column: str, cells: list[CellResult], paper: Figures) -> str:
  """One row per cell: scores, the paper's before ours, then rewards and achievements above the paper's."""
  published = [measure for measure in ("eval", "train") if any(paper.find(experiment.name, cell.name, measure) for cell in cells)]
  header, rows = [first_column, "seeds"], [[cell.label, str(cell.over("train").n) if cell.is_complete else ""] for cell in cells]
  for measure in ("eval", "eval_argmax", "train"):
    if measure in published:
      header.append("paper, evaluation" if measure == "eval" else "paper, training")
      for cell, row in zip(cells, rows):
        figure = paper.find(experiment.name, cell.name, measure)
        row.append(figure.text() if figure else "")
    header.append(MEASURES[measure].label)
    for cell, row in zip(cells, rows):
      with_seeds = cell.over(measure).n != cell.over("train").n  # unlike the column "seeds"
      row.append(_ours(cell, measure, with_seeds) if measure == "eval" or cell.is_complete else "")
  for measure in ("reward", "reward_last100", "unlocked"):
    header.append(MEASURES[measure].label)
    for cell, row in zip(cells, rows):
      ours = cell.over(measure).text() if cell.is_complete else ""
      row.append(_over_paper(ours, paper.find(experiment.name, cell.name, measure)))
  return markdown(header, rows) + _notes(cells)


def _milestone_table(experiment: ExperimentResult, cells: list[CellResult], paper: Figures) -> str:
  """Three rows per cell, a column per milestone."""
  rows = []
  for cell in cells:
    for measure in SCORES:
      row = [cell.label if measure == SCORES[0] else "", MEASURES[measure].label]
      for steps in experiment.milestones:
        spread = cell.group.scores_at(measure, steps) if cell.group else Spread()
        ours = f"{spread.text()} (n={spread.n})" if spread.n else "no run"
        if cell.group and not spread.n:
          is_reached = any(run.steps >= steps for run in cell.group.complete + cell.group.incomplete)
          ours = spread.text() if is_reached else "not reached"
        row.append(_over_paper(ours, _figure(paper, experiment.name, cell.name, measure, steps)))
      rows.append(row)
  header = [experiment.axes[0].name if experiment.axes else "", "", *(f"{steps:,} steps" for steps in experiment.milestones)]
  unfinished = any(cell.group and cell.group.incomplete for cell in cells)
  return markdown(header, rows) + ("Unfinished runs count up to the steps that they have reached.\n\n" if unfinished else "")


def _average(column: list[CellResult], measure: str) -> str:
  """The mean of a column's means and of its deviations, as in the average rows of the paper."""
  spreads = [spread for spread in (cell.over(measure) for cell in column) if spread.n]
  if len(spreads) < len(column):
    return f"{len(spreads)} of {len(column)} rows have runs"
  deviations = [spread.deviation for spread in spreads if spread.deviation is not None]
  deviation = float(np.mean(deviations)) if len(deviations) == len(column) else None
  return f"{mean_text(float(np.mean([spread.mean for spread in spreads])), deviation)} ({statistics.seeds_text(spreads)} each)"


def _is_shown(cells: Sequence[CellResult], with_runs: bool) -> bool:
  """Whether a row of these cells is in the table of rows with runs, or in that of rows without."""
  return any(cell.group for cell in cells) == with_runs


def _product_table(experiment: ExperimentResult, paper: Figures, with_runs: bool) -> str:
  """Two axes against each other: training and evaluation scores, followed by averages if the paper has them.

  If rows are folded, the averages come after them.
  """
  matrix = experiment.matrix(0, 1)
  row_axis, column_axis = experiment.axes
  rows, cells = [], []
  for choice, line in zip(row_axis.choices, matrix):
    if not _is_shown(line, with_runs):
      continue
    cells += line
    for measure in SCORES:
      rows.append([choice.label if measure == SCORES[0] else "", MEASURES[measure].label] + [
          _over_paper(_ours(cell, measure, with_seeds=True), _figure(paper, experiment.name, cell.name, measure)) for cell in line
      ])
  if not rows:
    return ""
  any_folded = not all(_is_shown(line, True) for line in matrix)
  if any_folded != with_runs:
    columns = [(choice.name, [line[number] for line in matrix]) for number, choice in enumerate(column_axis.choices)]
    for measure in SCORES:
      figures = [_figure(paper, experiment.name, f"{_AVERAGE}/{name}", measure) for name, _ in columns]
      if figures[0] is None:
        break
      rows.append([_AVERAGE if measure == SCORES[0] else "", MEASURES[measure].label] + [
          _over_paper(_average(column, measure), figure) for (_, column), figure in zip(columns, figures)])
  return markdown([row_axis.name, "", *(choice.label for choice in column_axis.choices)], rows) + _notes(cells)


def _pair_tables(experiment: ExperimentResult, with_runs: bool) -> str:
  text = ""
  for a, b in itertools.combinations(range(len(experiment.axes)), 2):
    rows = [[choice.label, *(_ours(cell, "train", with_seeds=True) for cell in line)]
            for choice, line in zip(experiment.axes[a].choices, experiment.matrix(a, b)) if _is_shown(line, with_runs)]
    header = [f"{experiment.axes[a].name} \\ {experiment.axes[b].name}, training score",
              *(choice.label for choice in experiment.axes[b].choices)]
    text += markdown(header, rows) if rows else ""
  return text


def _tables(experiment: ExperimentResult, paper: Figures, with_runs: bool) -> str:
  def cell_table(first_column, cells):
    cells = [cell for cell in cells if _is_shown([cell], with_runs)]
    if not cells:
      return ""
    if experiment.milestones:
      return _milestone_table(experiment, cells, paper)
    return _row_table(experiment, first_column, cells, paper)
  if not experiment.milestones and experiment.combine == "pairs":
    return _pair_tables(experiment, with_runs)
  if not experiment.milestones and experiment.has_two_axes:
    return _product_table(experiment, paper, with_runs)
  if experiment.milestones or experiment.combine == "product":
    return cell_table(experiment.axes[0].name if len(experiment.axes) == 1 else "", experiment.cells)
  return "".join(cell_table(axis.name, [cell for cell in experiment.cells if cell.axes[0] == number])
                 for number, axis in enumerate(experiment.axes))


def _cells_without_runs(experiment: ExperimentResult) -> str:
  labels = [cell.label for cell in experiment.cells if not cell.group]
  count = f"{len(labels)} cell{'' if len(labels) == 1 else 's'} without a run"
  return count if len(labels) > _NAMED_CELLS else f"{count}: {'; '.join(labels)}"


def experiment_tables(experiment: ExperimentResult, paper: Figures) -> str:
  """Our values and the paper's. Rows without a run are folded."""
  without_runs = _tables(experiment, paper, with_runs=False)
  return _tables(experiment, paper, with_runs=True) + (
      folded(_cells_without_runs(experiment), without_runs) if without_runs else "")


def achievement_table(cells: Sequence[CellResult]) -> str:
  """Success rates in percent: a row per achievement, a column per cell; the cells have complete runs."""
  columns = [cell.group.success() for cell in cells]
  rows = [[name, *(column[number].text() for column in columns)] for number, name in enumerate(ACHIEVEMENTS)]
  header = ["success rate, %", *(f"{cell.label} (n={len(cell.group.complete)})" for cell in cells)]
  return markdown(header, rows)


def scale_table(paper: Figures) -> str:
  """Published results of other players and agents."""
  rows = []
  for figure in paper.all:
    if figure.table == "scale" and figure.measure in ("train", "eval"):
      reward = paper.find("scale", figure.cell, "reward", figure.at)
      rows.append([figure.cell, figure.text(), reward.text() if reward else "", figure.source])
  return markdown(["", "Crafter score", "reward", "source"], rows)


# Tests and summaries.


def _p_text(p: float | None) -> str:
  return "" if p is None else "< 0.001" if p < 0.001 else f"{p:.3f}"


def _paper_tests(experiment: ExperimentResult, paper: Figures) -> str:
  """Welch's tests of cells with several seeds against the paper's figures."""
  rows = []
  for cell in experiment.cells:
    for measure in SCORES:
      figure = _figure(paper, experiment.name, cell.name, measure)
      ours = cell.over(measure)
      if figure is None or figure.deviation is None or figure.source != PAPER or ours.n < 2:
        continue
      theirs = Spread(PAPER_SEEDS, figure.mean, figure.deviation)
      rows.append([cell.label, MEASURES[measure].label, f"{ours.text()} (n={ours.n})", f"{theirs.text()} (n={theirs.n})",
                   f"{ours.mean - theirs.mean:+.1f}", _p_text(statistics.welch(ours, theirs))])
  return markdown(["against the paper", "", "ours", "paper", "difference", "p (Welch)"], rows) if rows else ""


def _cell_tests(experiment: ExperimentResult) -> str:
  """Welch's tests between the cells with several seeds."""
  rows = []
  for a, b in itertools.combinations([cell for cell in experiment.cells if cell.over("train").n > 1], 2):
    for measure in SCORES:
      first, second = a.over(measure), b.over(measure)
      if min(first.n, second.n) < 2:
        continue
      rows.append([f"{a.label} → {b.label}" if measure == SCORES[0] else "", MEASURES[measure].label,
                   f"{first.text()} (n={first.n})", f"{second.text()} (n={second.n})", f"{second.mean - first.mean:+.1f}",
                   _p_text(statistics.welch(first, second))])
  return markdown(["between cells", "", "first", "second", "difference", "p (Welch)"], rows) if rows else ""


def compared_rows(experiment: ExperimentResult, paper: Figures, measure: str, column: int) -> list[tuple[Spread, Figure]]:
  """Ours and the paper's in a column of a table of two axes, where both exist.

  Without what is evaluated where it was trained: that is no case of generalisation.
  """
  column_cells = [line[column] for line in experiment.matrix(0, 1) if line[column].is_complete]
  cells = [cell for cell in column_cells if "eval" in cell.group.first.settings]
  rows = [(cell.over(measure), _figure(paper, experiment.name, cell.name, measure)) for cell in cells]
  return [(ours, figure) for ours, figure in rows if ours.n and figure]


def _agreement_table(experiment: ExperimentResult, paper: Figures) -> str:
  """How far a table of two axes agrees with the paper's: differences, correlation, rows within two deviations."""
  rows = []
  for number, choice in enumerate(experiment.axes[1].choices):
    for measure in SCORES:
      compared = compared_rows(experiment, paper, measure, number)
      if not compared:
        continue
      differences = [ours.mean - figure.mean for ours, figure in compared]
      within = sum(abs(difference) <= 2 * (figure.deviation or 0) + 1e-9 for difference, (_, figure) in zip(differences, compared))
      expected = [statistics.expected_within_two_deviations(PAPER_SEEDS, ours.n) for ours, _ in compared]
      seeds = sorted({ours.n for ours, _ in compared})
      correlation = statistics.correlation([ours.mean for ours, _ in compared], [figure.mean for _, figure in compared])
      rows.append([choice.label, MEASURES[measure].label, str(len(compared)), ", ".join(map(str, seeds)),
                   f"{np.mean(differences):+.1f}", "" if correlation is None else f"{correlation:.2f}", str(within),
                   " to ".join(f"{sum(shares):.1f}" for shares in zip(*expected))])
  header = ["against the paper", "", "rows", "n of ours", "mean difference", "correlation", "within two deviations", "to expect"]
  return markdown(header, rows) if rows else ""


def test_tables(experiment: ExperimentResult, paper: Figures) -> str:
  if experiment.combine == "pairs":
    return ""
  if experiment.has_two_axes:
    return _agreement_table(experiment, paper)
  return _paper_tests(experiment, paper) + (
      "" if experiment.milestones or experiment.varies_one_of_several else _cell_tests(experiment))


# CSV, with all digits.


def number(value: float | None) -> str:
  if value is None or value != value:
    return ""
  return str(int(value)) if float(value).is_integer() else repr(float(value))


def _csv(header: str, rows: Sequence[Sequence[object]]) -> str:
  text = io.StringIO()
  writer = csv.writer(text, lineterminator="\n")
  writer.writerow(header.split(","))
  writer.writerows(rows)
  return text.getvalue()


def _cells(spread: Spread) -> list[str]:
  return [str(spread.n), number(spread.mean), number(spread.deviation)]


def _figure_cells(figure: Figure | None) -> list[str]:
  return ["", ""] if figure is None else [number(figure.mean), number(figure.deviation)]


def experiment_csv(experiment: ExperimentResult, paper: Figures) -> str:
  """A line for each cell and measure, and for each milestone; empty numbers for cells without a run.

  low and high: the 95% interval of the mean.
  """
  rows = []
  for cell in experiment.cells:
    for measure in MEASURES:
      interval = cell.group.interval(measure) if cell.group else None
      rows.append([experiment.name, cell.name, measure, "", *_cells(cell.over(measure)),
                   *_figure_cells(paper.find(experiment.name, cell.name, measure)), *map(number, interval or (None, None))])
    for steps in experiment.milestones:
      for measure in SCORES:
        spread = cell.group.scores_at(measure, steps) if cell.group else Spread()
        figure = paper.find(experiment.name, cell.name, measure, steps)
        rows.append([experiment.name, cell.name, measure, steps, *_cells(spread), *_figure_cells(figure), "", ""])
  return _csv("experiment,cell,measure,at,n,mean,std,paper_mean,paper_std,low,high", rows)


def _complete_cells(experiments: Sequence[ExperimentResult]) -> list[tuple[ExperimentResult, CellResult]]:
  return [(experiment, cell) for experiment in experiments for cell in experiment.cells if cell.is_complete]


def achievements_csv(experiments: Sequence[ExperimentResult]) -> str:
  """Success rates of training episodes in percent, of cells with complete runs."""
  rows = [[experiment.name, cell.name, name, *_cells(spread)] for experiment, cell in _complete_cells(experiments)
          for name, spread in zip(ACHIEVEMENTS, cell.group.success())]
  return _csv("experiment,cell,achievement,n,mean,std", rows)


def curves_csv(experiments: Sequence[ExperimentResult]) -> str:
  """Learning curves of complete runs."""
  rows = []
  for experiment, cell in _complete_cells(experiments):
    curve = spread_of_curves(cell.group.complete, curve_end(cell.group.first))
    rows += [[experiment.name, cell.name, steps, *_cells(score), number(reward.mean), number(reward.deviation)]
             for steps, score, reward in zip(curve.steps, curve.score, curve.reward)]
  return _csv("experiment,cell,steps,n,score_mean,score_std,reward_mean,reward_std", rows)


def runs_csv(runs: Sequence[Run], cells: dict[str, list[str]]) -> str:
  rows = [[run.folder, " ".join(cells.get(run.identity, [])), run.agent, run.env, run.eval_env, run.seed, run.config["steps"],
           run.steps, "yes" if run.complete else "no", *(number(measure.of(run)) for measure in MEASURES.values())] for run in runs]
  return _csv("folder,cells,agent,env,eval_env,seed,steps,reached,complete," + ",".join(MEASURES), rows)
