"""Counts of answers: right answers and trials at each level."""

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
