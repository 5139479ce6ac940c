"""The page of --html: a leaderboard of runs with curves, in one file."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence

from . import programs
from .logs import ACHIEVEMENTS, Curve
from .runs import Run

_MARKER = '<script type="application/json" id="report">null</script>'
_MOST_POINTS = 512  # of a curve


def _thinned(curve: Curve) -> list[int]:
  """Indices of every n-th point, where n is a power of two, and of the last."""
  stride = 1
  while len(curve) // stride >= _MOST_POINTS:
    stride *= 2
  kept = list(range(stride - 1, len(curve), stride))
  return kept if not len(curve) or len(curve) % stride == 0 else kept + [len(curve) - 1]


def _json_of(run: Run, name: str) -> dict:
  kept = _thinned(run.curve)
  return {
      "name": name, "agent": run.agent, "env": run.env, "seed": run.seed, "steps": run.steps, "complete": run.complete,
      "score": run.training.score, "evaluation": run.logs["eval_sampled"].score if len(run.logs["eval_sampled"]) else None,
      "reward": run.training.recent_reward, "unlocked": run.training.unlocked,
      "rates": {name: round(rate, 3) for name, rate in zip(ACHIEVEMENTS, run.training.success.tolist())},
      "curve": {"steps": run.curve.steps[kept].tolist(), "reward": [round(value, 3) for value in run.curve.reward[kept].tolist()],
                "score": [round(value, 3) for value in run.curve.score[kept].tolist()]},
  }


def web_page(runs: Sequence[Run]) -> str:
  folders = [run.folder for run in runs]
  common = os.path.commonprefix(folders).rpartition("/")[0] if len(runs) > 1 else ""
  begin = len(common) + 1 if common else 0
  report = json.dumps({"runs": [_json_of(run, run.folder[begin:]) for run in runs]})
  report = report.replace("<", "\\u003c")  # names of folders may contain anything, also the end of the script
  page = programs.ask([{"page": True}])[0]["page"]
  return page.replace(_MARKER, f'<script type="application/json" id="report">{report}</script>')
