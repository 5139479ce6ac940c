"""The look of all charts, and PNG files of them."""

from __future__ import annotations

import io

import matplotlib
import numpy as np
from PIL import Image

matplotlib.use("Agg")
from matplotlib import rcParams  # noqa: E402  pylint: disable=wrong-import-position
from matplotlib.figure import Figure  # noqa: E402  pylint: disable=wrong-import-position

# Colours that people with any colour vision can distinguish (Okabe and Ito 2008).
COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#000000")
PAPER_COLOR = "#bebebe"
_DOTS_PER_INCH = 90
_HIGHEST = 700  # inches; matplotlib draws at most 65,535 dots
_PALETTE = 96  # colours of a picture: a quarter of the size of one with all

matplotlib.rcdefaults()  # a matplotlibrc could ask for LaTeX
rcParams.update({
    "font.size": 8, "axes.titlesize": 9, "axes.edgecolor": "#828282", "axes.grid": True, "grid.color": "#e4e4e4",
    "axes.axisbelow": True, "axes.spines.top": False, "axes.spines.right": False, "legend.frameon": False,
    "legend.fontsize": 7, "svg.hashsalt": "craftfleet", "text.parse_math": False,  # names of folders may have dollars
})


def new_figure(width: float, height: float, rows: int = 1, columns: int = 1, **options) -> tuple[Figure, np.ndarray]:
  """A figure of that many inches, at most as high as can be drawn, and its axes by row and column."""
  figure = Figure(figsize=(width, min(height, _HIGHEST)), dpi=_DOTS_PER_INCH, layout="constrained")
  return figure, figure.subplots(rows, columns, squeeze=False, **options)


def steps_text(steps: float, _position: object = None) -> str:
  """Of an axis of environment steps: "300k", "1.5M"."""
  return f"{steps / 1e6:g}M" if steps >= 1e6 else f"{steps / 1e3:g}k" if steps >= 1e3 else f"{steps:g}"


def legend_name(name: str) -> str:
  """A name as a label: legends leave out labels that begin with an underscore."""
  return f" {name}" if name.startswith("_") else name


def finish_curve_axes(axes, title: str, label: str) -> None:
  axes.set(title=title, xlabel="environment steps", ylabel=label)
  axes.xaxis.set_major_formatter(steps_text)
  axes.margins(x=0)


def png(figure: Figure) -> bytes:
  """The same bytes for the same figure and version of matplotlib."""
  raw = io.BytesIO()
  figure.savefig(raw, format="png", metadata={"Software": None})
  packed = io.BytesIO()
  image = Image.open(raw).convert("RGB").quantize(_PALETTE, method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
  image.save(packed, "PNG", optimize=True)
  return packed.getvalue()
