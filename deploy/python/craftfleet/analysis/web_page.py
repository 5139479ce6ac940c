"""The page of --html: a leaderboard of runs with curves and success rates, in one file without scripts."""

from __future__ import annotations

import base64
import html
import os
from collections.abc import Sequence

from . import curve
from .charts import COLORS
from .logs import ACHIEVEMENTS
from .runs import Run

_STYLE = """:root { color-scheme: light dark; }
body { font: 15px/1.5 system-ui, sans-serif; max-width: 75rem; margin: auto; padding: 1rem; }
div { overflow-x: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
td { white-space: nowrap; }
th, td { padding: 0.2rem 0.7rem; border-bottom: 1px solid #8886; text-align: right; }
:is(th, td):first-child { text-align: left; }
img { max-width: 100%; }"""


def _table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
  lines = [f"<tr>{''.join(f'<{tag}>{html.escape(cell)}</{tag}>' for cell in cells)}</tr>\n"
           for tag, cells in [("th", header), *(("td", row) for row in rows)]]
  return f'<div tabindex="0">\n<table>\n{"".join(lines)}</table>\n</div>\n'


def _row(name: str, run: Run) -> list[str]:
  evaluation = f"{run.logs['eval_sampled'].score:.2f}" if len(run.logs["eval_sampled"]) else "-"
  return [name, f"{run.training.score:.2f}", f"{run.training.recent_reward:.2f}", evaluation, f"{run.training.unlocked}/22",
          f"{run.steps:,}" + ("" if run.complete else ", unfinished"), run.agent, run.env, str(run.seed)]


def web_page(runs: Sequence[Run]) -> str:
  """Runs by score; curves and success rates of as many of the best as there are colours."""
  common = os.path.commonprefix([run.folder for run in runs]).rpartition("/")[0] if len(runs) > 1 else ""
  named = sorted(((run.folder.removeprefix(common).lstrip("/") if common else run.folder, run) for run in runs),
                 key=lambda pair: -pair[1].training.score)
  shown = [(name, run) for name, run in named if len(run.training)][:len(COLORS)]
  page = (f'<!doctype html>\n<html lang="en">\n<meta charset="utf-8">\n<meta name="viewport" content="width=device-width">\n'
          f"<title>CraftFleet: report</title>\n<style>\n{_STYLE}\n</style>\n<h1>{len(runs)} run{'' if len(runs) == 1 else 's'}, "
          f"{sum(run.complete for run in runs)} complete</h1>\n<p>Scores are Crafter scores of all training episodes, rewards "
          "means of the last 100; evaluations are sampled.</p>\n")
  board = _table(["run", "score", "reward", "evaluation", "unlocked", "steps", "agent", "environment", "seed"],
                 [_row(name, run) for name, run in named])
  if not shown:
    return page + board
  picture = base64.b64encode(curve.draw([curve.NamedCurve(name, run.curve) for name, run in shown], [])).decode()
  page += f'<img alt="Reward and score over steps" src="data:image/png;base64,{picture}">\n<h2>Leaderboard</h2>\n{board}'
  rates = zip(ACHIEVEMENTS, *(run.training.success.tolist() for _, run in shown))
  return page + "<h2>Success rates, %</h2>\n" + _table(
      ["", *(name for name, _ in shown)], [[name.replace("_", " "), *(f"{rate:.1f}" for rate in of_runs)] for name, *of_runs in rates])
