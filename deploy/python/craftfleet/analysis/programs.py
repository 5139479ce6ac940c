"""Finds the program craftfleet, and asks it what only it knows: configurations, checkpoints, textures."""

from __future__ import annotations

import importlib.util
import json
import os
import pathlib
import re
import shutil
import subprocess


def find(name: str) -> tuple[list[str], dict[str, str]]:
  """The words that start `craftfleet NAME`, and its environment: of CRAFTFLEET_BIN, of the wheel, or of PATH.

  FileNotFoundError: there are no programs; ModuleNotFoundError: the program needs torch, and Python doesn't find it.
  """
  given = os.environ.get("CRAFTFLEET_BIN")
  if not given and importlib.util.find_spec("craftfleet_programs") is not None:
    import craftfleet_programs  # pylint: disable=import-outside-toplevel  # only wheels have it
    return craftfleet_programs.command("craftfleet", [name])
  path = shutil.which("craftfleet", path=given or None)
  if path is None:
    raise FileNotFoundError(
        f"craftfleet is not in {given or 'PATH'}: install a wheel that has the programs (deploy/wheel.sh), or put the folder of a "
        "build, such as build/bin, into PATH or CRAFTFLEET_BIN")
  return [os.path.realpath(path), name], dict(os.environ)


def ask(questions: list[dict]) -> list[dict]:
  """The answers of craftfleet inspect (deploy/cli/answer.h): each has an "error", or what was asked for."""
  if not questions:
    return []
  text = "".join(json.dumps(question, ensure_ascii=True) + "\n" for question in questions)
  words, environment = find("inspect")
  ended = subprocess.run(words, input=text, capture_output=True, text=True, check=False, env=environment)
  answers = [json.loads(line) for line in ended.stdout.splitlines()]
  if len(answers) != len(questions):
    raise ChildProcessError(f"craftfleet inspect ended early: {ended.stderr.strip()}")
  # It understands no names of files in other encodings, which Python reads as surrogates.
  strange = [[text for text in question.values() if re.search("[\ud800-\udfff]", str(text))] for question in questions]
  return [{"error": f"{texts[0]}: the name is not UTF-8"} if texts else answer for answer, texts in zip(answers, strange)]


def installed(name: str) -> str:
  """The path of a file of share/craftfleet, such as "experiments/paper.toml"; of the checkout where nothing is installed."""
  path = pathlib.Path(find("inspect")[0][0]).parents[1] / "share/craftfleet" / name
  if path.exists():
    return str(path)
  checkout = pathlib.Path(__file__).resolve().parents[3] / name  # deploy/
  if checkout.exists():
    return str(checkout)
  raise FileNotFoundError(f"{path} is missing: name the file with a flag, see --help")
