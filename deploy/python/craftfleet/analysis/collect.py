"""collect.py of deploy/experiments: keeps the result of a run."""

from __future__ import annotations

import os
import pathlib
import shutil

from . import _cli
from ._cli import Flag, Refusal, reason

PROGRAM = "collect.py"
USAGE = """deploy/experiments/collect.py [--weights] RUN_FOLDER RESULT keeps the result of a finished run: it writes configuration,
versions, and logs of episodes and evaluations to RESULT.npz. The programs are those of build/bin, or of the folder in
CRAFTFLEET_BIN."""
FLAGS = [
    Flag("weights", "bool", False, "also copy the newest checkpoint's weights to the folder RESULT\n"
         "with config.txt and run.json, so that craftfleet watch and eval play them"),
]


def _copy_weights(run: pathlib.Path, folder: pathlib.Path) -> None:
  """A full disk leaves no part of the folder."""
  from . import runs  # pylint: disable=import-outside-toplevel
  newest = runs.newest_checkpoint(run)
  made = folder.with_name(f".{folder.name}.new")
  made.mkdir(parents=True)
  try:
    for path in (run / "config.txt", run / "run.json", newest / "weights.safetensors"):
      shutil.copy(path, made / path.name)
    try:
      os.replace(made, folder)
    except OSError as error:
      raise OSError(error.errno, error.strerror, folder) from None  # not the name of the copy
  finally:
    shutil.rmtree(made, ignore_errors=True)


def _run(flags, paths: list[str]) -> int:
  from . import runs  # pylint: disable=import-outside-toplevel
  if len(paths) != 2:
    raise Refusal("name a run folder and the result; see --help")
  run, result = map(pathlib.Path, paths)
  try:
    result.parent.mkdir(parents=True, exist_ok=True)
    if flags.weights:
      _copy_weights(run, result)
    try:
      runs.save_result(str(run), f"{result}{runs.SUFFIX}")
    except (OSError, Refusal):
      if flags.weights:  # half a result would be in the way of the next call
        shutil.rmtree(result, ignore_errors=True)
      raise
  except OSError as error:
    raise Refusal(f"cannot collect {run}: {reason(error)}") from None
  return 0


def main(arguments: list[str]) -> int:
  return _cli.run(PROGRAM, USAGE, FLAGS, arguments, _run)
