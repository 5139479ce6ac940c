"""The arguments of vector environments: seeds, lanes and actions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from craftfleet import _arguments


def seeds(seed: int | Sequence[int | None] | None, lanes: int) -> list[int | None]:
  """A seed for each lane: `seed + i`, the i-th of a list, or None."""
  if seed is None:
    return [None] * lanes
  if hasattr(seed, "__len__"):
    if len(seed) != lanes:
      raise ValueError(f"{len(seed)} seeds, want one for each of {lanes} lanes")
    return [None if s is None else _arguments.seed(s, f"seed[{lane}]") for lane, s in enumerate(seed)]
  first = _arguments.integer("seed", seed, 0, _arguments.MAX_SEED - lanes)
  return [first + lane for lane in range(lanes)]


def chosen(options: dict[str, Any] | None, lanes: int) -> list[int]:
  """The lanes that reset() is for: those of options["reset_mask"], or all."""
  if options is not None and not isinstance(options, dict):
    raise TypeError(f"options {options!r}, want a dict such as {{'reset_mask': mask}}")
  mask = (options or {}).get("reset_mask")
  if mask is None:
    return list(range(lanes))
  if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_ or mask.shape != (lanes,) or not mask.any():
    raise ValueError(f"reset_mask {mask!r}, want a NumPy array of {lanes} booleans, at least one of them True")
  return np.flatnonzero(mask).tolist()


def actions(values: Any, lanes: int) -> np.ndarray:
  """int64[lanes]; their range is not checked."""
  array = np.asarray(values)
  if array.dtype.kind not in "iu":
    raise TypeError(f"actions of type {array.dtype}, want integers")
  if array.shape != (lanes,):
    raise ValueError(f"actions of shape {array.shape}, want ({lanes},)")
  return np.ascontiguousarray(array, np.int64)
