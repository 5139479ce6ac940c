"""craftfleet report: makes the paper's tables and figures from runs."""

from __future__ import annotations

import os
import sys

from . import _cli, experiments, figures, programs
from ._cli import Flag, OutputFile, Refusal

PROGRAM = "craftfleet report"
USAGE = """craftfleet report DIR... makes the paper's tables from the runs in or below the given folders: mean and standard
deviation over seeds with 95% intervals, compared with the paper's; success rates, learning curves with their spread, and
heatmaps; as Markdown, CSV and PNG. A run is a folder with config.txt and stats.jsonl, or a result file that
deploy/experiments/collect.py made of one. Its configuration determines the cell of the table. The report marks cells
without a run, and lists unfinished runs without averaging them. A run that cannot be read is named in a warning and left
out; if there is no other, the program ends with its error.

  craftfleet report runs/paper --out=report
  craftfleet report runs/paper --out=report --html
  craftfleet report deploy/experiments/results --out=deploy/experiments/report --csv=false"""
FLAGS = [
    Flag("out", "string", "",
         "folder for the report: report.md, CSV files, pictures; -: report.md alone, on standard output (required)"),
    Flag("html", "bool", False,
         "also make report.html: a leaderboard of the runs with curves, in one file for browsers that needs no other"),
    Flag("csv", "bool", True, "make the CSV files, which have all digits"),
    Flag("experiments", "string", "", "file with the experiments to make tables for [those of the paper]"),
    Flag("figures", "string", "", "CSV file with published figures to compare with [the paper's]"),
]
PAGE = "report.md"
_NAMED_CELLS = 2  # of a run, in the list of runs

_READING = """How to read it:
- Scores are Crafter scores: exp(mean of ln(1 + success rate in percent)) - 1 over the 22 achievements, as in Hafner 2021; the
  paper prints the formula without the "- 1". The training score covers all training episodes of a run. Evaluation scores cover
  all evaluation episodes during training, with sampled actions or with the most likely ones (argmax). The paper's Table 1,
  ablations and asymptotic table are evaluation figures. It does not say how their actions were chosen, so both of ours are shown.
- Numbers are means ± sample standard deviations (n - 1) over n seeds; a single seed has no deviation. The paper's have n = 10.
  In brackets: 95% intervals of the mean by bootstrap, over seeds where there are three or more. With fewer they are over
  episodes, which says how exactly these runs were measured, not how others would do. They are too narrow where n is small: of
  normal scores they hold the mean in 75% of cases with three seeds, 84% with five, 90% with nine; over 100 episodes in 89%.
- p is that of Welch's test. "Within two deviations" counts rows whose figure is within two of the paper's deviations;
  "to expect" is the count if our runs were further seeds of the paper's, with and without allowance for its n.
- Unfinished runs are listed but not averaged. "no run" marks a cell without a run.
- A run belongs to a cell if its whole configuration matches, wherever its folder is. Cells with the same configuration share runs.

"""


def _cells_text(names: list[str]) -> str:
  """"table1/ppo_cnn, ood_app/ordinary/ppo_cnn and 18 more"."""
  more = len(names) - _NAMED_CELLS
  return ", ".join(names[:_NAMED_CELLS]) + (f" and {more} more" if more > 0 else "") or "-"


def _runs_table(runs, cells) -> str:
  from . import tables  # pylint: disable=import-outside-toplevel
  rows = []
  for run in runs:
    training = run.training
    shown = [f"{training.score:.2f}", f"{training.recent_reward:.2f}", f"{training.unlocked}/22"] if len(training) else ["-"] * 3
    rows.append([run.folder, _cells_text(cells.get(run.identity, [])), str(run.seed), run.steps_text(),
                 "yes" if run.complete else "no", str(len(training)), *shown])
  header = ["folder", "cells", "seed", "steps", "complete", "episodes", "training score", "reward, last 100", "unlocked"]
  return tables.markdown(header, rows)


def _heading(runs, results) -> str:
  cells = [cell for result in results if not result.is_own for cell in result.cells]
  filled = len({cell.identity for cell in cells if cell.is_complete})
  complete = sum(run.complete for run in runs)
  return (f"# Report\n\n{len(runs):,} run{'' if len(runs) == 1 else 's'}, {complete} of them complete; {filled} of "
          f"{len({cell.identity for cell in cells})} configurations have a complete run ({len(cells)} cells, some of which share "
          "one). Made by `craftfleet report`.\n\n")


def _section(result, paper, files: dict[str, bytes]) -> str:
  """The part of report.md about an experiment that has runs; adds its pictures to `files`."""
  from . import pictures, tables  # pylint: disable=import-outside-toplevel
  text = f"## {result.title}\n\n{tables.experiment_tables(result, paper)}{tables.test_tables(result, paper)}"
  for picture in pictures.experiment_pictures(result, paper):
    text += f"![{picture.title}]({picture.name})\n\n"
    files[picture.name] = picture.content
  if result.combine == "pairs":
    return text
  parts = [[cell for cell in part if cell.is_complete] for part in pictures.chart_parts(result)]
  return text + "".join(tables.achievement_table(part) for part in parts if part)


def make_report(all_experiments, paper, runs, with_csv: bool = True) -> dict[str, bytes]:
  """Contents by file name: report.md, which shows the pictures; EXPERIMENT.csv for each experiment; other.csv for runs that
  belong to none; runs.csv, achievements.csv, curves.csv; PNG files."""
  from . import results, tables  # pylint: disable=import-outside-toplevel
  matched = results.match(all_experiments, results.group_runs(runs))
  cells = results.cell_names(all_experiments)
  files: dict[str, bytes] = {}
  text = _heading(runs, matched) + _READING + "".join(_section(result, paper, files) for result in matched if result.has_runs)
  text += f"## Runs\n\n{_runs_table(runs, cells)}"
  empty = "".join(f"{result.title}:\n\n{tables.experiment_tables(result, paper)}" for result in matched if not result.has_runs)
  text += f"## Experiments without a run\n\n{empty}" if empty else ""
  text += f"## Others, for scale\n\n{tables.scale_table(paper)}" if paper.all else ""
  files[PAGE] = text.encode()
  if with_csv:
    for result in matched:
      files[f"{result.name}.csv"] = tables.experiment_csv(result, paper).encode()
    files["runs.csv"] = tables.runs_csv(runs, cells).encode()
    files["achievements.csv"] = tables.achievements_csv(matched).encode()
    files["curves.csv"] = tables.curves_csv(matched).encode()
  return files


def check_target(out: str) -> None:
  """Refusal: the report cannot be written there. Creates nothing."""
  if _cli.is_stream(out):
    return
  above = os.path.abspath(out)
  while not os.path.lexists(above):
    above = os.path.dirname(above)
  if os.path.isdir(out):
    OutputFile("--out", os.path.join(out, PAGE))
  elif not os.path.isdir(above):
    raise Refusal(f"--out: {above} is not a folder; want a folder, or - for standard output")
  elif not os.access(above, os.W_OK | os.X_OK):
    raise Refusal(f"--out: cannot create a folder in {above}: Permission denied")


def write(out: str, files: dict[str, bytes]) -> int:
  """Replaces files of the report's names in a folder; none if one of them cannot be written. A stream takes report.md alone.

  Returns how many were written.
  """
  if _cli.is_stream(out):
    OutputFile("--out", out).write(files[PAGE])
    return 1
  try:
    os.makedirs(out, exist_ok=True)
  except OSError as error:
    raise Refusal(f"--out: cannot create {out}: {error.strerror}") from None
  opened = [(OutputFile("--out", os.path.join(out, name)), content) for name, content in sorted(files.items())]
  for file, content in opened:
    file.write(content)
  return len(opened)


def _run(flags, folders: list[str]) -> int:
  from . import pictures, runs as run_files  # noqa: F401  pylint: disable=import-outside-toplevel,unused-import
  if not folders:
    raise Refusal("name at least one folder with runs; see --help")
  if not flags.out:
    raise Refusal("--out is missing: the folder for the report")
  check_target(flags.out)
  all_experiments = experiments.load(flags.experiments or programs.installed("experiments/paper.toml"))
  paper = figures.load(flags.figures or programs.installed("experiments/paper_figures.csv"))
  runs, unreadable = run_files.read_runs(folders)
  if not runs:
    raise Refusal(unreadable[0] if unreadable else
                  f"no run in or below {', '.join(folders)}, want a folder with config.txt and stats.jsonl")
  for problem in unreadable:
    _cli.warn(f"left out: {problem}")
  files = make_report(all_experiments, paper, runs, flags.csv)
  if flags.html:
    from . import web_page  # pylint: disable=import-outside-toplevel
    files["report.html"] = web_page.web_page(runs).encode()
  written = write(flags.out, files)
  is_standard_output = flags.out in _cli.STANDARD_OUTPUT
  people = sys.stderr if is_standard_output else sys.stdout
  more = f"{len(unreadable)} more cannot be read; " if unreadable else ""
  place = "standard output" if is_standard_output else flags.out
  where = f"report.md written to {place}" if written == 1 else f"{written} files in {flags.out}, begin with report.md"
  print(f"{len(runs)} run{'' if len(runs) == 1 else 's'}, {sum(run.complete for run in runs)} complete; {more}{where}", file=people)
  return 0


def main(arguments: list[str]) -> int:
  return _cli.run(PROGRAM, USAGE, FLAGS, arguments, _run)
