"""Figures of published tables, for comparison with ours."""

from __future__ import annotations

import dataclasses

from ._cli import Refusal, read_text

HEADER = "table,cell,measure,at,mean,std,source"


def mean_text(mean: float, deviation: float | None) -> str:
  """"10.3 ± 0.6", "10.3"."""
  return f"{mean:.1f}" if deviation is None else f"{mean:.1f} ± {deviation:.1f}"


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
    return mean_text(self.mean, self.deviation)


class Figures:
  """The figures of a file, found by table, cell, measure and steps."""

  def __init__(self, text: str, filename: str):
    """Refusal: the line that is invalid."""
    self._found: dict[tuple, Figure] = {}
    lines = [(number, line.strip()) for number, line in enumerate(text.splitlines(), 1) if line.strip() and line.strip()[0] != "#"]
    if not lines or lines[0][1] != HEADER:
      raise Refusal(f"{filename}:{lines[0][0] if lines else 1}: want the columns' names, {HEADER}")
    for number, line in lines[1:]:
      try:
        table, cell, measure, at, mean, deviation, source = line.split(",")
        figure = Figure(table, cell, measure, int(at or 0), float(mean), float(deviation) if deviation else None, source)
      except ValueError as error:
        raise Refusal(f"{filename}:{number}: {error}, want {HEADER}") from None
      key = (table, cell, measure, figure.at)
      if key in self._found:
        raise Refusal(f"{filename}:{number}: {table} {cell} {measure} occurs twice")
      self._found[key] = figure

  @property
  def all(self) -> list[Figure]:
    return list(self._found.values())

  def find(self, table: str, cell: str, measure: str, at: int = 0) -> Figure | None:
    return self._found.get((table, cell, measure, at))


def load(path: str) -> Figures:
  """Refusal: the file cannot be read, or as Figures."""
  return Figures(read_text(path), path)
