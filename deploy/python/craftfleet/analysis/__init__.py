"""Learning curves, tables and sweeps of training runs: craftfleet report, curve and sweep, and their parts for notebooks.

    from craftfleet import analysis
    runs = analysis.load("runs")                       # a DataFrame with a row for each run
    analysis.episodes("runs/first", "eval_sampled")    # and one with a row for each episode

The commands need the programs of CraftFleet (CRAFTFLEET_BIN or PATH) to understand configurations and checkpoints.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
  from .runs import Run, episodes, load, read_runs

__all__ = ["Run", "episodes", "load", "read_runs"]


def __getattr__(name: str) -> Any:
  # craftfleet sweep works where NumPy and pandas are not installed.
  if name in __all__:
    from . import runs  # pylint: disable=import-outside-toplevel
    return getattr(runs, name)
  raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
  return [*globals(), *__all__]
