"""Counts of answers: right answers and trials at each level.

Signal detection: d' of two-interval choices, and a person's preference for an interval (criterion c).

Macmillan and Creelman, Detection Theory, 2nd edition, chapters 7 and 8.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float, Int
from scipy.special import betaincinv, ndtri

from jaxgrasp.validation.checked import checked


@dataclass(frozen=True, eq=False)
class Counts:
    """Right answers by level, in rising order; levels without a trial are left out.

    Raises:
        ValueError: for arrays of different lengths, levels that are not finite or there twice, and more right answers
            than trials.
    """

    levels: Float[np.ndarray, "L"]
    """Levels of the comparison: difference from the reference by the reference [1], intensity in detection, or any
    other finite numbers: signed differences, logarithms (dB). Which signs a fit allows depends on its shape."""
    hits: Int[np.ndarray, "L"]
    """Right answers."""
    trials: Int[np.ndarray, "L"]

    def __post_init__(self):
        levels, hits, trials = np.asarray(self.levels, float), np.asarray(self.hits), np.asarray(self.trials)
        if not (levels.ndim == 1 and levels.shape == hits.shape == trials.shape):
            raise ValueError(f"levels, hits, trials have shapes {levels.shape}, {hits.shape}, {trials.shape}")
        for k in range(len(levels)):
            if not np.isfinite(levels[k]):
                raise ValueError(f"levels[{k}] is {levels[k]}: expected a finite number")
            if levels[k] in levels[:k]:
                raise ValueError(f"levels[{k}] is {levels[k]} again: expected each level once")
            for name, values in (("hits", hits), ("trials", trials)):
                if values[k] != np.floor(values[k]) or values[k] < 0:
                    raise ValueError(f"{name}[{k}] is {values[k]}: expected a whole number, 0 or more")
            if hits[k] > trials[k]:
                raise ValueError(f"hits[{k}] is {hits[k]}: expected at most its {trials[k]} trials")
        order = np.argsort(levels)[trials[np.argsort(levels)] > 0]
        for name, values in (("levels", levels), ("hits", hits.astype(int)), ("trials", trials.astype(int))):
            object.__setattr__(self, name, values[order])

    @property
    def ratios(self) -> Float[np.ndarray, "L"]:
        """Shares of right answers."""
        return self.hits / self.trials


@checked
def count(levels: Float[np.ndarray, "T"], correct: np.ndarray) -> Counts:
    """Count answers, one for each trial, by their levels."""
    distinct, inverse = np.unique(np.asarray(levels, float), return_inverse=True)
    correct = np.asarray(correct, bool)
    return Counts(
        distinct, np.bincount(inverse[correct], minlength=len(distinct)), np.bincount(inverse, minlength=len(distinct))
    )


@checked
def pooled(parts: "list[Counts]") -> Counts:
    """Add the counts of several sets of answers, level by level."""
    levels = np.unique(np.concatenate([part.levels for part in parts])) if parts else np.zeros(0)
    hits, trials = np.zeros(len(levels), int), np.zeros(len(levels), int)
    for part in parts:
        at = np.searchsorted(levels, part.levels)
        hits[at] += part.hits
        trials[at] += part.trials
    return Counts(levels, hits, trials)


def ratio_intervals(
    counts: Counts, coverage: float = 0.95, method: Literal["wilson", "exact"] = "wilson"
) -> Float[np.ndarray, "L 2"]:
    """Compute the interval ``(L, 2)`` of each hit ratio.

    Args:
        counts: of answers.
        coverage: of each interval.
        method: ``"wilson"`` (score) or ``"exact"`` (Clopper and Pearson).
    """
    interval = wilson if method == "wilson" else exact
    return interval(counts.hits, counts.trials, coverage)


def wilson(hits: Int[np.ndarray, "..."], trials: Int[np.ndarray, "..."], coverage: float) -> Float[np.ndarray, "... 2"]:
    """Compute Wilson's score intervals of binomial shares."""
    z = ndtri((1 + coverage) / 2)
    # (k + z^2/2 -+ z sqrt(k (n - k) / n + z^2/4)) / (n + z^2).
    centre = (hits + z**2 / 2) / (trials + z**2)
    half_width = z / (trials + z**2) * np.sqrt(hits * (trials - hits) / trials + z**2 / 4)
    return np.clip(np.stack([centre - half_width, centre + half_width], -1), 0, 1)


def exact(hits: Int[np.ndarray, "..."], trials: Int[np.ndarray, "..."], coverage: float) -> Float[np.ndarray, "... 2"]:
    """Compute Clopper and Pearson's intervals of binomial shares."""
    tail = (1 - coverage) / 2
    misses = trials - hits
    low = np.where(hits > 0, betaincinv(np.maximum(hits, 1), misses + 1, tail), 0.0)
    high = np.where(misses > 0, betaincinv(hits + 1, np.maximum(misses, 1), 1 - tail), 1.0)
    return np.stack([low, high], -1)


@dataclass(frozen=True)
class DetectionSensitivity:
    """Sensitivity and preference in choices between two intervals at one level."""

    d_prime: float
    """Distance of the two sensations by the noise of each."""
    low: float
    high: float
    """End of the interval from ``low``, by the variances of both shares (Gourevitch and Galanter 1967)."""
    lean: float
    """Criterion c: positive where a person prefers to name the second interval, 0 without preference; NaN where one
    order was never tried."""
    corrected: bool
    """True where half an answer was added to each count, since a share was 0 or 1."""


@checked
def detection_sensitivity(
    first_hits: int, first_trials: int, second_hits: int, second_trials: int, coverage: float = 0.95
) -> DetectionSensitivity:
    """Compute d' from answers where the stronger stimulus came first, and where it came second.

    Args:
        first_hits: right answers where it came first.
        first_trials: trials where it came first.
        second_hits: right answers where it came second.
        second_trials: trials where it came second.
        coverage: of the interval.

    Raises:
        ValueError: for counts that are no counts, or without any trial.
    """
    for name, hits, trials in (("first", first_hits, first_trials), ("second", second_hits, second_trials)):
        if not 0 <= hits <= trials:
            raise ValueError(f"{name}_hits is {hits}: expected 0 to {name}_trials, {trials}")
    if first_trials + second_trials == 0:
        raise ValueError("first_trials and second_trials are 0: expected at least one trial")
    corrected = any(k in (0, n) for k, n in ((first_hits, first_trials), (second_hits, second_trials)) if n)
    add = 0.5 if corrected else 0.0
    first, second = (_z(k + add, n + 2 * add) for k, n in ((first_hits, first_trials), (second_hits, second_trials)))
    if first_trials and second_trials:
        # "First" said of a first one is a hit, said of a second one a false alarm.
        # d' = (z1 + z2) / sqrt(2), c = (z2 - z1) / 2.
        d_prime, variance, lean = (first[0] + second[0]) / np.sqrt(2), (first[1] + second[1]) / 2, second[0] - first[0]
    else:
        value, spread = first if first_trials else second
        d_prime, variance, lean = np.sqrt(2) * value, 2 * spread, np.nan
    half_width = float(ndtri((1 + coverage) / 2)) * np.sqrt(variance)
    return DetectionSensitivity(
        float(d_prime), float(d_prime - half_width), float(d_prime + half_width), float(lean) / 2, corrected
    )


def _z(hits: float, trials: float) -> tuple[float, float]:
    """Compute the normal quantile of a share, and its variance; NaN for no trials."""
    if not trials:
        return np.nan, np.nan
    share = hits / trials
    z = float(ndtri(share))
    return z, share * (1 - share) / trials * 2 * np.pi * float(np.exp(z**2))
