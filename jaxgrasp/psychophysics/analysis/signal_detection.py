"""Signal detection: d' of two-interval choices, and a person's preference for an interval (criterion c).

Macmillan and Creelman, Detection Theory, 2nd edition, chapters 7 and 8.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from jaxgrasp.validation.checked import checked


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
