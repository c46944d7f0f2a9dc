"""Thresholds by straight lines through hit ratios, for many sets of ratios at once."""

import numpy as np
from jaxtyping import Float

Ratios = Float[np.ndarray, "*batch L"]


def by_interpolation(levels: Float[np.ndarray, "L"], ratios: Ratios, criterion: float) -> Float[np.ndarray, "*batch"]:
    """Compute the level at which the ratio first passes the criterion, on straight lines from level to level.

    If it never passes from below: minus infinity where it is above at the smallest level, else infinity.
    """
    below, above = ratios[..., :-1] < criterion, ratios[..., 1:] >= criterion
    passes = below & above
    first = np.argmax(passes, -1)
    low, high = (np.take_along_axis(ratios, first[..., None] + k, -1)[..., 0] for k in (0, 1))
    with np.errstate(invalid="ignore", divide="ignore"):
        share = (criterion - low) / (high - low)
    crossings = levels[first] + share * (levels[first + 1] - levels[first])
    return np.where(passes.any(-1), crossings, np.where(ratios[..., 0] >= criterion, -np.inf, np.inf))


def by_line(levels: Float[np.ndarray, "L"], ratios: Ratios, criterion: float) -> Float[np.ndarray, "*batch"]:
    """Compute the level at which the line of least squares passes the criterion; NaN where it does not rise."""
    centred = levels - levels.mean()
    slope = ratios @ centred / (centred @ centred)
    with np.errstate(invalid="ignore", divide="ignore"):
        crossings = levels.mean() + (criterion - ratios.mean(-1)) / slope
    return np.where(slope > 0, crossings, np.nan)


def by_line_from_chance(
    levels: Float[np.ndarray, "L"], ratios: Ratios, criterion: float, chance: float
) -> Float[np.ndarray, "*batch"]:
    """Compute the level of ``by_line`` with chance at level zero as a further point.

    Of many estimators, this is the only one that gives the paper's results.
    """
    at_zero = np.full((*ratios.shape[:-1], 1), chance)
    return by_line(np.concatenate([[0.0], levels]), np.concatenate([at_zero, ratios], -1), criterion)
