"""Intervals by drawing answers anew."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float
from scipy.special import ndtr, ndtri

from jaxgrasp.psychophysics.analysis.counts import Counts

Estimator = Callable[[Float[np.ndarray, "B L"]], Float[np.ndarray, "B"]]
"""Thresholds from hits ``(B, L)``; NaN or infinite where there is none."""


def draw(
    counts: Counts, chances: Float[np.ndarray, "L"], resamples: int, rng: np.random.Generator
) -> Float[np.ndarray, "B L"]:
    """Draw hits ``(B, L)`` of as many trials at the same levels, by the chance at each level."""
    return rng.binomial(counts.trials, np.clip(chances, 0, 1), (resamples, len(counts.levels))).astype(float)


def percentile_interval(found: Float[np.ndarray, "B"], coverage: float) -> tuple[float, float]:
    """Compute the interval between two quantiles; resamples without a threshold count as infinite."""
    tail = (1 - coverage) / 2
    low, high = np.quantile(np.where(np.isnan(found), np.inf, found), [tail, 1 - tail], method="nearest")
    return float(low), float(high)


def bca_interval(
    found: Float[np.ndarray, "B"], estimate: float, counts: Counts, estimator: Estimator, coverage: float
) -> tuple[float, float]:
    """Compute the interval with bias and acceleration corrected (Efron 1987), the latter by the jackknife."""
    known = np.where(np.isnan(found), np.inf, found)
    share = np.clip(np.mean(known < estimate) + 0.5 * np.mean(known == estimate), 1 / len(known), 1 - 1 / len(known))
    bias = ndtri(share)
    acceleration = _acceleration(counts, estimator)
    ends = []
    for z in ndtri([(1 - coverage) / 2, (1 + coverage) / 2]):
        moved = bias + (bias + z) / (1 - acceleration * (bias + z))
        ends.append(float(np.quantile(known, ndtr(moved), method="nearest")))
    return ends[0], ends[1]


def _acceleration(counts: Counts, estimator: Estimator) -> float:
    """Compute the acceleration by the jackknife: a hit left out lowers a level's ratio, a miss left out raises it."""
    ratios, trials = counts.ratios, counts.trials
    without_hit = (counts.hits - 1) / np.maximum(trials - 1, 1)
    without_miss = counts.hits / np.maximum(trials - 1, 1)
    rows, weights = [], []
    for k in range(len(trials)):
        for left, weight in ((without_hit[k], counts.hits[k]), (without_miss[k], trials[k] - counts.hits[k])):
            if weight and trials[k] > 1:
                moved = ratios.copy()
                moved[k] = left
                rows.append(moved * trials)
                weights.append(weight)
    if not rows:
        return 0.0
    values = estimator(np.array(rows))
    used = np.isfinite(values)
    if used.sum() < 2:
        return 0.0
    values, counted = values[used], np.array(weights)[used]
    away = np.average(values, weights=counted) - values
    scale = np.sum(counted * away**2) ** 1.5
    return float(np.sum(counted * away**3) / (6 * scale)) if scale > 0 else 0.0
