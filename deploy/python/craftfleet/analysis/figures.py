"""Figures of published tables, for comparison with ours."""

from __future__ import annotations

import dataclasses

from ._cli import Refusal, read_text

HEADER = "table,cell,measure,at,mean,std,source"


@dataclasses.dataclass(frozen=True)
class Figure:
  table: str  # an experiment's name; "scale": other players and agents, for comparison
  cell: str
  measure: str
  at: int  # environment steps, if the table has several; 0: at the end
  mean: float
  deviation: float | None
  source: str

  def text(self) -> str:
    return f"{self.mean:.1f}" if self.deviation is None else f"{self.mean:.1f} ± {self.deviation:.1f}"


class Figures:
  """The figures of a file, found by table, cell, measure and steps."""

  def __init__(self, text: str, filename: str):
    """Refusal: the line that is invalid."""
    self.all: list[Figure] = []
    self._found: dict[tuple, Figure] = {}
    header = False
    for number, line in enumerate(text.split("\n"), 1):
      line = line.strip()
      if not line or line.startswith("#"):
        continue
      try:
        if header:
          self._add(line)
        elif line != HEADER:
          raise Refusal(f"want the columns' names, {HEADER}")
      except Refusal as error:
        raise Refusal(f"{filename}:{number}: {error}") from None
      header = True
    if not header:
      raise Refusal(f"{filename}: empty, want {HEADER}")

  def _add(self, line: str) -> None:
    cells = line.split(",")
    if len(cells) != len(HEADER.split(",")):
      raise Refusal(f"{len(cells)} columns, want {len(HEADER.split(','))}: {HEADER}")
    table, cell, measure, at, mean, deviation, source = cells
    figure = Figure(table, cell, measure, int(_number("at", at, int) or 0), _number("mean", mean, float, needed=True),
                    _number("std", deviation, float), source)
    key = (table, cell, measure, figure.at)
    if key in self._found:
      raise Refusal(f"{table} {cell} {measure} occurs twice")
    self._found[key] = figure
    self.all.append(figure)

  def find(self, table: str, cell: str, measure: str, at: int = 0) -> Figure | None:
    return self._found.get((table, cell, measure, at))


def _number(name: str, text: str, kind: type, needed: bool = False):
  if not text and not needed:
    return None
  try:
    return kind(text)
  except ValueError:
    want = "a number" if needed else "a number or nothing" if kind is float else "a whole number or nothing"
    raise Refusal(f'{name} is "{text}", want {want}') from None


def load(path: str) -> Figures:
  """Refusal: the file cannot be read, or as Figures."""
  return Figures(read_text(path), path)
