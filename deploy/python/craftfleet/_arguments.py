"""Checks what a user passes. Messages name the argument, its value and what was expected."""

from __future__ import annotations

import copyreg
import functools
import importlib.util
import operator
import os
import pathlib
import re
from typing import Any

from craftfleet import _engine

MAX_INT = 2**31 - 1
MAX_SEED = 2**63 - 1

Pair = tuple[int, int]


def integer(name: str, value: Any, low: int, high: int) -> int:
  """`value` as an int of low..high. TypeError: no integer; ValueError: out of range."""
  try:
    number = operator.index(value)
  except TypeError:
    raise TypeError(f"{name} {value!r}, want an integer of {low}..{high}") from None
  if not low <= number <= high:
    raise ValueError(f"{name} {number}, want {low}..{high}")
  return number


def seed(value: Any, name: str = "seed") -> int:
  return integer(name, value, -2**63, MAX_SEED)


def pair(name: str, value: Any) -> Pair:
  """Two positive integers; one stands for both."""
  parts = tuple(value) if hasattr(value, "__len__") else (value, value)
  if len(parts) != 2:
    raise ValueError(f"{name} {value!r}, want one or two integers")
  return integer(f"{name}[0]", parts[0], 1, MAX_INT), integer(f"{name}[1]", parts[1], 1, MAX_INT)


def picture_size(name: str, value: Any, setup: _engine.Setup) -> Pair:
  """The pixels of a picture. ValueError: not what the view allows."""
  size = pair(name, value)
  try:
    setup.check_picture(size)
  except ValueError as error:
    raise ValueError(f"{name} {value!r}: {error}") from None
  return size


def render_mode(value: Any) -> str | None:
  if value not in (None, "rgb_array"):
    raise ValueError(f"render_mode {value!r}, want None or 'rgb_array'")
  return value


def check_env_name(env: Any) -> None:
  if not isinstance(env, str):
    raise TypeError(f"env {env!r}, want the name of an environment like 'crafter:numbers=easy-x2'")
  _check_text("env", env)


def _check_text(name: str, value: str) -> None:
  """Refuses what the engine cannot take: surrogates, as which Python reads names of other encodings, and NUL."""
  if re.search("[\0\ud800-\udfff]", value):
    raise ValueError(f"{name} {value!r}, want a name in UTF-8 without NUL")


def check_snapshot(name: str, value: Any) -> None:
  if not isinstance(value, bytes):
    raise TypeError(f"{name} of type {type(value).__name__}, want bytes of snapshot()")


def texture_folder(textures: str | os.PathLike[str] | None) -> str:
  """The folder that `textures` means: None the built-in ones (""), "crafter" those of the installed package, else a path."""
  if textures is None:
    return ""
  if textures == "crafter":
    found = importlib.util.find_spec("crafter")
    if found is None or not found.submodule_search_locations:
      raise FileNotFoundError('textures "crafter": the package is not installed, want: pip install crafter')
    return str(pathlib.Path(found.submodule_search_locations[0]) / "assets")
  try:
    folder = pathlib.Path(textures).expanduser().absolute()
  except TypeError:
    raise TypeError(f"textures {textures!r}, want None, 'crafter' or a folder") from None
  _check_text("textures", str(folder))
  if folder.exists() and not folder.is_dir():
    raise NotADirectoryError(f"textures {str(folder)!r}, want a folder of PNG files")
  return str(folder)


def setup(env: str, area: Any, view: Any, size: Any, length: Any, textures: Any) -> _engine.Setup:
  """The engine's setup. ValueError, TypeError or FileNotFoundError: an argument is refused."""
  check_env_name(env)
  steps = integer("length", 0 if length is None else length, 0, 10**9)
  return _shared_setup(env, pair("area", area), pair("view", view), pair("size", size), steps, texture_folder(textures))


def _shared_setup(env: str, area: Pair, view: Pair, size: Pair, length: int, textures: str) -> _engine.Setup:
  """Environments with equal arguments share textures and pictures drawn beforehand, until a texture is edited."""
  files = sorted(file for file in pathlib.Path(textures).glob("*.png") if file.exists()) if textures else []
  return _made_setup(env, area, view, size, length, textures, tuple((file.name, file.stat().st_mtime_ns) for file in files))


@functools.lru_cache(maxsize=32)
def _made_setup(
    env: str, area: Pair, view: Pair, size: Pair, length: int, textures: str, _: tuple[tuple[str, int], ...]) -> _engine.Setup:
  try:
    return _engine.Setup.create(env, area, view, size, length, textures)
  except ValueError as error:
    raise ValueError(f"env={env!r}, area={area}, view={view}, size={size}, length={length}: {error}") from None


def _restored_game(shared: _engine.Setup, seed_: int, snapshot: bytes | None) -> _engine.Game:
  game = _engine.Game(shared, seed_)
  if snapshot is not None:
    game.restore(snapshot)
  return game


# How copies and pickles of environments carry the engine's objects.
_engine.Setup.__deepcopy__ = lambda shared, _: shared  # immutable
copyreg.pickle(_engine.Setup, lambda shared: (_shared_setup, shared.arguments))
copyreg.pickle(_engine.Game, lambda game: (_restored_game, (game.setup, game.seed, game.save() if game.started else None)))
