"""Learning curves, tables and sweeps of training runs: craftfleet report, curve and sweep, and their parts for notebooks.

    from craftfleet import analysis
    runs = analysis.load("runs")                       # a DataFrame with a row for each run
    analysis.episodes(runs["run"][0], "eval_sampled")  # and one with a row for each episode

The commands need the programs of CraftFleet (CRAFTFLEET_BIN or PATH) to understand configurations and checkpoints.
"""


def __getattr__(name: str):
  # craftfleet sweep works where NumPy and pandas are not installed.
  if name in ("Run", "episodes", "load", "read_runs"):
    from . import runs  # pylint: disable=import-outside-toplevel
    return getattr(runs, name)
  raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
