"""Finds the program craftfleet, and asks it what only it knows: configurations, checkpoints, textures."""

from __future__ import annotations

import importlib.util
import json
import os
import pathlib
import shutil
import subprocess


def _folder() -> str:
  """The folder of the programs: CRAFTFLEET_BIN, that of the wheel, or that of the craftfleet in PATH; "": there is none."""
  given = os.environ.get("CRAFTFLEET_BIN")
  if given:
    return given
  wheel = importlib.util.find_spec("craftfleet_programs")
  if wheel is not None and wheel.origin:
    return os.path.join(os.path.dirname(wheel.origin), "bin")
  found = shutil.which("craftfleet")
  return os.path.dirname(os.path.realpath(found)) if found else ""


def command(name: str) -> list[str]:
  """The words that start `craftfleet NAME`.   FileNotFoundError: craftfleet neither runs this, nor is it in a wheel or in PATH."""
  path = os.path.join(_folder(), "craftfleet")
  if os.path.exists(path):
    return [path, name]
  raise FileNotFoundError(f"{path} is missing: it must be in PATH, or in the folder that the environment variable CRAFTFLEET_BIN names")


def ask(questions: list[dict]) -> list[dict]:
  """The answers of craftfleet inspect (deploy/cli/answer.h): each has an "error", or what was asked for."""
  if not questions:
    return []
  text = "".join(json.dumps(question, ensure_ascii=True) + "\n" for question in questions)
  ended = subprocess.run(command("inspect"), input=text, capture_output=True, text=True, check=False)
  answers = [json.loads(line) for line in ended.stdout.splitlines()]
  if len(answers) != len(questions):
    raise ChildProcessError(f"craftfleet inspect ended early: {ended.stderr.strip()}")
  return answers


def installed(name: str) -> str:
  """The path of a file of share/craftfleet, such as "experiments/paper.toml"; of the checkout where nothing is installed."""
  path = pathlib.Path(_folder()).parent / "share/craftfleet" / name
  if path.exists():
    return str(path)
  checkout = pathlib.Path(__file__).resolve().parents[3] / name  # deploy/
  if checkout.exists():
    return str(checkout)
  raise FileNotFoundError(f"{path} is missing: name the file with a flag, see --help")
