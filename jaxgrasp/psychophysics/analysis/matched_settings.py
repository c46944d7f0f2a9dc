"""Constant and variable errors of a person's settings in the matching of two stimuli."""

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri, stdtrit

from jaxgrasp.psychophysics.observer import QUARTILE


@dataclass(frozen=True)
class Matched:
    """Constant and variable error of one person at one reference. NaN where there are too few settings."""

    subject: str
    reference: float
    settings: int
    error: float
    """Mean setting less the reference: the constant error, in the stimulus' unit."""
    error_low: float
    error_high: float
    deviation: float
    """Standard deviation of the settings: the variable error."""
    deviation_low: float
    deviation_high: float
    saturated: int = 0
    """Settings in which a torque was cut."""

    @property
    def jnd(self) -> float:
        """Difference that would be told apart in three of four choices, if the noise of both tasks is the same."""
        return QUARTILE * self.deviation


def matched(
    subject: str, reference: float, settings: list[float], coverage: float = 0.95, saturated: int = 0
) -> Matched:
    """Compute the mean and the deviation with their intervals, for settings that are normally distributed."""
    values, count = np.asarray(settings, float), len(settings)
    if count < 2:
        error = float(values[0] - reference) if count else np.nan
        return Matched(subject, reference, count, error, -np.inf, np.inf, np.nan, 0.0, np.inf, saturated)
    error, deviation = float(values.mean() - reference), float(values.std(ddof=1))
    tail = (1 - coverage) / 2
    half_width = float(-stdtrit(count - 1, tail)) * deviation / np.sqrt(count)
    low, high = (deviation * float(np.sqrt((count - 1) / chdtri(count - 1, share))) for share in (tail, 1 - tail))
    return Matched(
        subject, reference, count, error, error - half_width, error + half_width, deviation, low, high, saturated
    )
