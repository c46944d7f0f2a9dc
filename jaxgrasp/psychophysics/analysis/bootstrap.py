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


def percentile_interval(estimates: Float[np.ndarray, "B"], coverage: float) -> tuple[float, float]:
    """Compute the interval between two quantiles; resamples without a threshold count as infinite."""
    tail = (1 - coverage) / 2
    low, high = np.quantile(np.where(np.isnan(estimates), np.inf, estimates), [tail, 1 - tail], method="nearest")
    return float(low), float(high)


def bca_interval(
    estimates: Float[np.ndarray, "B"], estimate: float, counts: Counts, estimator: Estimator, coverage: float
) -> tuple[float, float]:
    """Compute the interval with bias and acceleration corrected (Efron 1987), the latter by the jackknife."""
    finite_or_inf = np.where(np.isnan(estimates), np.inf, estimates)
    share = np.clip(
        np.mean(finite_or_inf < estimate) + 0.5 * np.mean(finite_or_inf == estimate),
        1 / len(finite_or_inf),
        1 - 1 / len(finite_or_inf),
    )
    bias = ndtri(share)
    acceleration = _acceleration(counts, estimator)
    ends = []
    for z in ndtri([(1 - coverage) / 2, (1 + coverage) / 2]):
        # z' = z0 + (z0 + z) / (1 - a (z0 + z)); the end is the quantile at Phi(z').
        corrected_z = bias + (bias + z) / (1 - acceleration * (bias + z))
        ends.append(float(np.quantile(finite_or_inf, ndtr(corrected_z), method="nearest")))
    return ends[0], ends[1]


def _acceleration(counts: Counts, estimator: Estimator) -> float:
    """Compute the acceleration by the jackknife: a hit left out lowers a level's ratio, a miss left out raises it."""
    ratios, trials = counts.ratios, counts.trials
    without_hit = (counts.hits - 1) / np.maximum(trials - 1, 1)
    without_miss = counts.hits / np.maximum(trials - 1, 1)
    rows, weights = [], []
    for k in range(len(trials)):
        for ratio_without, weight in ((without_hit[k], counts.hits[k]), (without_miss[k], trials[k] - counts.hits[k])):
            if weight and trials[k] > 1:
                jackknifed = ratios.copy()
                jackknifed[k] = ratio_without
                rows.append(jackknifed * trials)
                weights.append(weight)
    if not rows:
        return 0.0
    values = estimator(np.array(rows))
    is_finite = np.isfinite(values)
    if is_finite.sum() < 2:
        return 0.0
    values, counted = values[is_finite], np.array(weights)[is_finite]
    deviations = np.average(values, weights=counted) - values
    # a = sum d^3 / (6 (sum d^2)^1.5), with d the jackknife's mean less each of its values.
    scale = np.sum(counted * deviations**2) ** 1.5
    return float(np.sum(counted * deviations**3) / (6 * scale)) if scale > 0 else 0.0
