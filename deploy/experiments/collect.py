#!/usr/bin/env python3
"""Keeps the result of a finished run: writes configuration, versions, and logs of episodes and evaluations to RESULT.npz.

Usage: deploy/experiments/collect.py [--weights] RUN_FOLDER RESULT
  --weights  also copies the newest checkpoint's weights to the folder RESULT, with config.txt and run.json, so that
             craftfleet watch and eval play them
The programs are those of build/bin, or of the folder in CRAFTFLEET_BIN.
"""

import os
import pathlib
import shutil
import sys

SYSTEM_PYTHON = "/usr/bin/python3"
ROOT = pathlib.Path(__file__).resolve().parents[2]

os.environ.setdefault("CRAFTFLEET_BIN", str(ROOT / "build/bin"))
sys.path.insert(0, str(ROOT / "deploy/python/craftfleet"))
try:
  from analysis import runs  # noqa: E402
  from analysis._cli import Refusal, reason  # noqa: E402
except ImportError as error:
  if not os.path.exists(SYSTEM_PYTHON) or os.environ.get("CRAFTFLEET_SECOND_PYTHON"):
    sys.exit(f"collect.py: {error}; want python3-matplotlib")
  os.environ["CRAFTFLEET_SECOND_PYTHON"] = "1"
  os.execv(SYSTEM_PYTHON, [SYSTEM_PYTHON, *sys.argv])


def copy_weights(run, folder):
  """A full disk leaves no part of the folder."""
  newest = max((path for path in (run / "checkpoints").iterdir() if path.name[:5] == "iter-" and path.name[5:].isdigit()),
               key=lambda path: int(path.name[5:]), default=None)
  if newest is None:
    raise Refusal(f"{run}/checkpoints: no checkpoint")
  made = folder.with_name(f".{folder.name}.new")
  made.mkdir(parents=True)
  try:
    for path in (run / "config.txt", run / "run.json", newest / "weights.safetensors"):
      shutil.copy(path, made / path.name)
    os.replace(made, folder)
  finally:
    shutil.rmtree(made, ignore_errors=True)


def main(arguments):
  with_weights = "--weights" in arguments
  paths = [argument for argument in arguments if argument != "--weights"]
  if len(paths) != 2 or any(path.startswith("-") for path in paths):
    print(__doc__, file=sys.stdout if paths[:1] in (["-h"], ["--help"]) else sys.stderr)
    return 0 if paths[:1] in (["-h"], ["--help"]) else 2
  run, result = map(pathlib.Path, paths)
  try:
    result.parent.mkdir(parents=True, exist_ok=True)
    if with_weights:
      copy_weights(run, result)
    runs.save_result(str(run), f"{result}{runs.SUFFIX}")
  except (Refusal, OSError) as error:
    print(f"collect.py: {reason(error)}", file=sys.stderr)
    return 1
  return 0


sys.exit(main(sys.argv[1:]))
