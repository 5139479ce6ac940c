"""Reads the run folders of CraftFleet and the statistics of recorders: learner/run/FORMATS.md in the repository."""

from __future__ import annotations

import dataclasses
import json
import math
import operator
import os
import pathlib
import struct
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from craftfleet import _engine
from craftfleet.analysis import logs, runs as run_files

if TYPE_CHECKING:
  import pandas


@dataclasses.dataclass(frozen=True)
class Score:
  """What the episodes of a file amount to."""

  score: float  # Crafter's score, 0..100
  success_rates: dict[str, float]  # percent of the episodes that unlocked each achievement at least once
  reward: float  # mean over the episodes
  length: float  # mean, in steps
  episodes: int


def score(path: str | os.PathLike[str]) -> Score:
  """Crafter's score of a stats.jsonl, plain or .gz, or of the folder with it: exp(mean of ln(1 + success rate)) - 1.

  FileNotFoundError: no such file; ValueError: no finished episode in it, or a line that is none.
  """
  file = pathlib.Path(path).expanduser()
  if file.is_dir():
    file = next((file / name for name in ("stats.jsonl", "stats.jsonl.gz") if (file / name).exists()), file / "stats.jsonl")
  file.stat()
  if file.suffix == run_files.SUFFIX:
    raise ValueError(f"{file}: want a stats.jsonl or the folder with it; analysis.load() reads result files")
  try:
    episodes = logs.read_log(str(file))
  except logs.Refusal as error:
    raise ValueError(str(error)) from None
  if not len(episodes):
    raise ValueError(f"{file}: no finished episode, want a line of JSON for each")
  rates = dict(zip(_engine.ACHIEVEMENTS, episodes.success.tolist()))
  return Score(episodes.score, rates, episodes.reward, float(episodes.length.mean()), len(episodes))


def load_weights(run: str | os.PathLike[str]) -> dict[str, np.ndarray]:
  """The weights of a run's newest checkpoint by name, float32; `run` may also be a checkpoint or a .safetensors file.

  FileNotFoundError: there are none; ValueError: no such file.
  """
  path = pathlib.Path(run).expanduser()
  if (path / "checkpoints").is_dir():
    path = run_files.newest_checkpoint(path)
  if path.is_dir():
    path = path / "weights.safetensors"
  content = path.read_bytes()
  try:
    size = int.from_bytes(content[:8], "little")
    header, data = json.loads(content[8:8 + size]), memoryview(content)[8 + size:]
    return {name: _tensor(tensor, data) for name, tensor in header.items() if name != "__metadata__"}
  except (AttributeError, KeyError, RecursionError, TypeError, ValueError) as error:
    raise ValueError(f"{path}: not the weights of a checkpoint ({error}), want a safetensors file of float32") from None


def load_curves(run: str | os.PathLike[str]) -> pandas.DataFrame:
  """The curves of a run: a row for each number of environment steps, a column for each tag of TensorBoard. Needs pandas.

  The tags are those of learner/run/FORMATS.md, section 6, such as "rollout/crafter_score". FileNotFoundError: there are none; ValueError: the
  file is damaged.
  """
  import pandas  # pylint: disable=import-outside-toplevel  # takes half a second, and only this needs it
  rows: dict[int, dict[str, float]] = {}
  path = pathlib.Path(run).expanduser() / "events.out.tfevents.craftfleet"
  if not path.exists():
    raise FileNotFoundError(f"{path}: no curves, want the folder of a run")
  for event in _records(path.read_bytes()):
    try:
      step, values = _numbers(event)
    except (AttributeError, IndexError, KeyError, TypeError, UnicodeDecodeError, struct.error):
      raise ValueError(f"{path}: damaged, want the events of a run") from None
    rows.setdefault(step, {}).update(values)
  steps = sorted(step for step, row in rows.items() if row)
  return pandas.DataFrame([rows[step] for step in steps], index=pandas.Index(steps, name="env_steps"))


def _numbers(event: bytes) -> tuple[int, dict[str, float]]:
  """The step of an event, and its number of each tag."""
  fields = list(_fields(event))
  step = operator.index(next((value for number, value in fields if number == 2), 0))
  values = [dict(_fields(value)) for number, summary in fields if number == 5 for _, value in _fields(summary)]
  # A value's field 1 is its tag, field 2 a number; histograms and pictures have others.
  return step, {value[1].decode(): struct.unpack("<f", value[2])[0] for value in values if 2 in value}


def _records(content: bytes) -> Iterator[bytes]:
  """The records of a TFRecord file, without one that is being written."""
  position = 0
  while position + 12 <= len(content):
    size = int.from_bytes(content[position:position + 8], "little")
    if position + 16 + size > len(content):
      return
    yield content[position + 12:position + 12 + size]
    position += 16 + size


def _fields(message: bytes) -> Iterator[tuple[int, Any]]:
  """Number and value of each field of a Protobuf message: an integer, or bytes."""
  position = 0

  def varint() -> int:
    nonlocal position
    value = shift = 0
    while True:
      byte = message[position]
      position += 1
      value |= (byte & 127) << shift
      shift += 7
      if byte < 128:
        return value

  while position < len(message):
    key = varint()
    if key & 7 == 0:
      yield key >> 3, varint()
      continue
    size = {1: 8, 5: 4}.get(key & 7) or varint()
    yield key >> 3, message[position:position + size]
    position += size


def _tensor(tensor: dict, data: memoryview) -> np.ndarray:
  begin, end = tensor["data_offsets"]
  if tensor["dtype"] != "F32" or not 0 <= begin <= end <= len(data):
    raise ValueError(f"a tensor of {tensor['dtype']} at {begin}..{end} of {len(data)} bytes")
  shape = tensor["shape"]
  if any(operator.index(length) < 0 for length in shape) or 4 * math.prod(shape) != end - begin:
    raise ValueError(f"a tensor of shape {shape} in {end - begin} bytes")
  return np.frombuffer(data[begin:end], "<f4").reshape(shape).astype(np.float32)
