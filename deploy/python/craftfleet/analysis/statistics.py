"""Means over seeds, intervals and tests.

Intervals are percentile bootstraps as in rliable (Agarwal et al. 2021): of three seeds or more, seeds are drawn again; of
fewer, the episodes of each run, which says how exactly a run was measured and nothing about other seeds.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from .figures import mean_text
from .logs import Episodes, crafter_score

FEWEST_SEEDS = 3  # for a bootstrap over seeds
_DRAWS = 1000
_AT_A_TIME = 100  # bounds the memory for runs of many episodes
_SEED = 20221101  # the same intervals each time


@dataclasses.dataclass(frozen=True)
class Spread:
  """Mean and sample deviation (n - 1) of one number for each seed."""

  n: int = 0
  mean: float = math.nan
  deviation: float | None = None  # with two seeds or more

  def text(self) -> str:
    """"10.3 ± 0.6"; "10.3" with one seed, "-" with none."""
    return mean_text(self.mean, self.deviation) if self.n else "-"


def spread_of(values: Sequence[float]) -> Spread:
  if len(values) == 0:
    return Spread()
  deviation = float(np.std(values, ddof=1)) if len(values) > 1 else None
  return Spread(len(values), float(np.mean(values)), deviation)


def seeds_text(spreads: Sequence[Spread]) -> str:
  """Their numbers of seeds: "n=3", "n=1 to 5"."""
  seeds = sorted({spread.n for spread in spreads})
  return f"n={seeds[0]}" if len(seeds) == 1 else f"n={seeds[0]} to {seeds[-1]}"


def interval_over_seeds(values: Sequence[float]) -> tuple[float, float]:
  """95% interval of the mean."""
  random = np.random.default_rng(_SEED)
  draws = random.choice(np.asarray(values, float), (_DRAWS, len(values))).mean(axis=1)
  low, high = np.percentile(draws, [2.5, 97.5])
  return float(low), float(high)


def interval_over_episodes(runs: Sequence[Episodes]) -> tuple[float, float]:
  """95% interval of the mean score of `runs`, each with at least one episode."""
  random = np.random.default_rng(_SEED)
  scores = np.zeros(_DRAWS)
  for run in runs:
    # Drawing episodes is drawing how often each set of achievements occurs.
    sets, numbers = np.unique(run.counts > 0, axis=0, return_counts=True)
    for begin in range(0, _DRAWS, _AT_A_TIME):
      drawn = random.multinomial(len(run), numbers / len(run), _AT_A_TIME)
      scores[begin:begin + _AT_A_TIME] += crafter_score(100 * (drawn @ sets.astype(float)) / len(run)) / len(runs)
  low, high = np.percentile(scores, [2.5, 97.5])
  return float(low), float(high)


def _beyond(t: float, freedom: float) -> float:
  """The probability of a value beyond -t or t under Student's t distribution."""
  # With t = sqrt(freedom) tan(a), the density is that of cos(a)^(freedom - 1).
  low = math.atan(abs(t) / math.sqrt(freedom))
  angle = np.linspace(low, math.pi / 2, 20001)
  density = np.cos(angle)**(freedom - 1)
  area = float(((density[1:] + density[:-1]) * np.diff(angle)).sum() / 2)
  whole = math.sqrt(math.pi) * math.exp(math.lgamma(freedom / 2) - math.lgamma((freedom + 1) / 2)) / 2
  return area / whole


def welch(a: Spread, b: Spread) -> float | None:
  """The p-value of Welch's test that two means are equal; None without two values on each side, or without any spread."""
  if min(a.n, b.n) < 2 or a.deviation is None or b.deviation is None:
    return None
  va, vb = a.deviation**2 / a.n, b.deviation**2 / b.n
  if va + vb == 0:
    return None
  freedom = (va + vb)**2 / (va**2 / (a.n - 1) + vb**2 / (b.n - 1))
  return _beyond((a.mean - b.mean) / math.sqrt(va + vb), freedom)


def expected_within_two_deviations(seeds: int, ours: int = 1) -> tuple[float, float]:
  """The share of means over `ours` runs to expect within two deviations of a mean over `seeds`, if nothing else differs.

  The first allows for mean and deviation being estimates, the second takes them as exact.
  """
  estimated = 1 - _beyond(2 / math.sqrt(1 / ours + 1 / seeds), seeds - 1)
  return estimated, math.erf(2 * math.sqrt(ours) / math.sqrt(2))


def correlation(a: Sequence[float], b: Sequence[float]) -> float | None:
  """Pearson's; None for fewer than three pairs, or where one side does not vary."""
  if len(a) < 3 or np.std(a) == 0 or np.std(b) == 0:
    return None
  return float(np.corrcoef(a, b)[0, 1])
