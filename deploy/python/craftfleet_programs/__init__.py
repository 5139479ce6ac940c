"""Starts the programs of a wheel, which are in bin/ beside this file, with the LibTorch of Python's torch.

deploy/wheel.sh puts this package into wheels. It imports nothing large: commands start in milliseconds.
"""

from __future__ import annotations

import importlib.util
import json
import os
import pathlib
import re
import sys

BIN = pathlib.Path(__file__).resolve().parent / "bin"
# "libtorch": the version that the programs were linked with, "2.11"; "needs_libtorch": the programs and commands, such as
# "craftfleet train", that were.
BUILD = json.loads((BIN.parent / "build.json").read_text(encoding="utf-8"))


def command(program: str, arguments: list[str]) -> tuple[list[str], dict[str, str]]:
  """The command of a program with arguments, and its environment.

  ModuleNotFoundError: it needs torch, and this Python has none, or another version.
  """
  environment = dict(os.environ)
  torch = _torch()
  if torch is not None and _version(torch) == BUILD["libtorch"]:
    # Also for programs without LibTorch: they may start others.
    environment["LD_LIBRARY_PATH"] = ":".join(filter(None, (str(torch / "lib"), os.environ.get("LD_LIBRARY_PATH"))))
  elif not {program, " ".join([program, *arguments[:1]])}.isdisjoint(BUILD["needs_libtorch"]):
    found = "this Python has none" if torch is None else f"{torch} is {_version(torch)}"
    raise ModuleNotFoundError(f"needs torch {BUILD['libtorch']}, and {found}: pip install 'craftfleet[train]'", name="torch")
  environment["CRAFTFLEET_PYTHON"] = sys.executable  # for the commands in Python
  return [str(BIN / program), *arguments], environment


def main() -> None:
  """Becomes the program whose name this script has."""
  program, arguments = pathlib.Path(sys.argv[0]).name, sys.argv[1:]
  if arguments[:1] == ["help"] and len(arguments) > 1:
    arguments = [arguments[1], "--help"]
  try:
    words, environment = command(program, arguments)
  except ModuleNotFoundError as error:
    sys.exit(f"{' '.join([program, *arguments[:1]]) if program == 'craftfleet' else program}: {error}")
  os.execve(words[0], words, environment)


def _torch() -> pathlib.Path | None:
  """The folder of Python's torch, which is not imported: that takes seconds."""
  spec = importlib.util.find_spec("torch")
  folders = [pathlib.Path(folder) for folder in (spec.submodule_search_locations or [])] if spec is not None else []
  return next((folder for folder in folders if (folder / "lib/libtorch_cpu.so").exists()), None)


def _version(torch: pathlib.Path) -> str:
  """Its version, "2.11"."""
  found = re.search(r"^__version__ = '(\d+\.\d+)", (torch / "version.py").read_text(encoding="utf-8"), re.MULTILINE)
  return found[1] if found else "of unknown version"
