"""The view of signal detection: d' of two-interval choices, and how far a person leans to one interval.

Macmillan and Creelman, Detection Theory, 2nd edition, chapters 7 and 8.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from jaxgrasp.psychophysics.analysis.counts import wilson


@dataclass(frozen=True)
class Sensitivity:
    """Of choices between two intervals at one level."""

    d_prime: float
    """Distance of the two sensations by the noise of each."""
    low: float
    high: float
    """Its interval, by Wilson's for the share of right answers where the order does not matter."""
    lean: float
    """Criterion c: positive where a person prefers to name the second interval, 0 without preference; NaN where one
    order was never tried."""
    corrected: bool
    """Whether half an answer was added to each count, since one of the shares was 0 or 1."""


def sensitivity(
    first_hits: int, first_trials: int, second_hits: int, second_trials: int, coverage: float = 0.95
) -> Sensitivity:
    """d' from answers where the stronger stimulus came first, and where it came second.

    Args:
        first_hits: right answers where it came first.
        first_trials: of how many.
        second_hits: right answers where it came second.
        second_trials: of how many.
        coverage: of the interval.

    Raises:
        ValueError: for counts that are no counts, or without any trial.
    """
    for name, hits, trials in (("first", first_hits, first_trials), ("second", second_hits, second_trials)):
        if not 0 <= hits <= trials:
            raise ValueError(f"{name}_hits is {hits}: expected 0 to {name}_trials, {trials}")
    hits, trials = first_hits + second_hits, first_trials + second_trials
    if trials == 0:
        raise ValueError("first_trials and second_trials are 0: expected a trial")
    ends = wilson(np.array(hits), np.array(trials), coverage)
    corrected = any(k in (0, n) for k, n in ((first_hits, first_trials), (second_hits, second_trials)) if n)
    add = 0.5 if corrected else 0.0

    def z(hits: int, trials: int) -> float:
        return float(ndtri((hits + add) / (trials + 2 * add)))

    low, high = (float(np.sqrt(2) * ndtri(end)) for end in ends)
    if first_trials and second_trials:
        # "First" said of a first one is a hit, said of a second one a false alarm.
        hit, false_alarm = z(first_hits, first_trials), -z(second_hits, second_trials)
        return Sensitivity((hit - false_alarm) / np.sqrt(2), low, high, -(hit + false_alarm) / 2, corrected)
    return Sensitivity(np.sqrt(2) * z(hits, trials), low, high, np.nan, corrected)
