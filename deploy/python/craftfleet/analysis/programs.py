"""Finds CraftFleet's programs, and asks craftfleet-inspect what only they know: configurations, checkpoints, textures."""

from __future__ import annotations

import json
import os
import pathlib
import shutil
import subprocess


def find(name: str) -> str:
  """The path of a program: in the folder CRAFTFLEET_BIN, beside the command that runs, or in PATH.

  FileNotFoundError: it is in neither.
  """
  folder = os.environ.get("CRAFTFLEET_BIN")
  path = os.path.join(folder, name) if folder else shutil.which(name)
  if path and os.path.exists(path):
    return path
  raise FileNotFoundError(f"{path or name} is missing: it must be in the same folder as this program, in PATH, or in the folder "
                          "that the environment variable CRAFTFLEET_BIN names")


def ask(questions: list[dict]) -> list[dict]:
  """The answers of craftfleet-inspect (deploy/cli/inspect/answer.h): each has an "error", or what was asked for."""
  if not questions:
    return []
  text = "".join(json.dumps(question, ensure_ascii=True) + "\n" for question in questions)
  ended = subprocess.run([find("craftfleet-inspect")], input=text, capture_output=True, text=True, check=False)
  answers = [json.loads(line) for line in ended.stdout.splitlines()]
  if len(answers) != len(questions):
    raise ChildProcessError(f"craftfleet-inspect ended early: {ended.stderr.strip()}")
  return answers


def installed(name: str) -> str:
  """The path of a file of share/craftfleet, such as "experiments/paper.toml"; of the checkout where nothing is installed."""
  folder = os.environ.get("CRAFTFLEET_BIN") or os.path.dirname(os.path.realpath(shutil.which("craftfleet") or ""))
  path = pathlib.Path(folder).parent / "share/craftfleet" / name
  if path.exists():
    return str(path)
  checkout = pathlib.Path(__file__).resolve().parents[3] / name  # deploy/
  if checkout.exists():
    return str(checkout)
  raise FileNotFoundError(f"{path} is missing: name the file with a flag, see --help")
