"""Just noticeable differences and Weber fractions, with their intervals; and Weber's law with a floor."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from jaxgrasp.psychophysics.analysis.threshold import Threshold
from jaxgrasp.validation.checked import checked


@dataclass(frozen=True)
class Weber:
    """Just noticeable difference and Weber fraction at one reference, with their intervals."""

    reference: float
    jnd: float
    """Just noticeable difference in the reference's unit."""
    jnd_low: float
    jnd_high: float
    fraction: float
    """Weber fraction: the just noticeable difference by the reference."""
    fraction_low: float
    fraction_high: float


@checked
def weber(threshold: Threshold, reference: float, spread: float = 0.0) -> Weber:
    """Compute the Weber fraction from a threshold that is a difference by the reference.

    Args:
        threshold: of the comparisons, as a difference by the reference.
        reference: of the comparisons, positive.
        spread: relative standard deviation of the reference as it was rendered, which widens the fraction's interval.

    Raises:
        ValueError: for a reference that is not positive, or a negative spread.
    """
    if not (np.isfinite(reference) and reference > 0):
        raise ValueError(f"reference is {reference}: expected a positive number")
    if not (np.isfinite(spread) and spread >= 0):
        raise ValueError(f"spread is {spread}: expected a finite number, 0 or more")
    value, low, high = threshold.value, threshold.low, threshold.high
    jnd = (reference * value, reference * low, reference * high)
    if spread and np.isfinite(value) and value > 0:
        # The two errors have nothing to do with each other: their relative sizes add as squares.
        added = 1.96 * spread * value
        low = max(0.0, value - np.hypot(value - low, added))
        high = value + np.hypot(high - value, added)
    return Weber(reference, *jnd, value, low, high)


@dataclass(frozen=True)
class WeberLine:
    """JND = limit x reference + floor: Weber's law, and Fechner's additive noise where references are small."""

    limit: float
    """Weber fraction of large references [1]."""
    floor: float
    """JND at no reference: the absolute threshold, in the reference's unit."""
    limit_deviation: float
    floor_deviation: float
    """Standard deviations, from the JNDs' own; NaN where those are not known and two points leave no residual."""


@checked
def weber_line(
    references: Float[np.ndarray, "R"],
    jnds: Float[np.ndarray, "R"],
    deviations: Float[np.ndarray, "R"] | None = None,
) -> WeberLine:
    """Fit the line of least squares through JNDs, each weighted by its standard deviation where these are given.

    Raises:
        ValueError: for fewer than two references, JNDs that are not finite, or deviations that are not positive.
    """
    references, jnds = np.asarray(references, float), np.asarray(jnds, float)
    if len(references) < 2 or len(np.unique(references)) < 2:
        raise ValueError(f"references are {references.tolist()}: expected at least two different references")
    for k, jnd in enumerate(jnds):
        if not np.isfinite(jnd):
            raise ValueError(f"jnds[{k}] is {jnd}: expected a finite number")
    scale = np.ones(len(jnds)) if deviations is None else np.asarray(deviations, float)
    for k, deviation in enumerate(scale):
        if not (np.isfinite(deviation) and deviation > 0):
            raise ValueError(f"deviations[{k}] is {deviation}: expected a positive number")
    table = np.column_stack([references, np.ones(len(references))]) / scale[:, None]
    # Weighted least squares: (limit, floor) = (A^T A)^-1 A^T y, with rows divided by their deviations.
    inverse = np.linalg.inv(table.T @ table)
    limit, floor = inverse @ table.T @ (jnds / scale)
    spread = 1.0
    if deviations is None:
        residuals = jnds - limit * references - floor
        freedom = len(jnds) - 2
        spread = float(residuals @ residuals / freedom) if freedom else np.nan
    errors = np.sqrt(spread * np.diag(inverse))
    return WeberLine(float(limit), float(floor), float(errors[0]), float(errors[1]))
