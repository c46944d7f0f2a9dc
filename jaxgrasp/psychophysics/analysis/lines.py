"""Thresholds by straight lines through hit ratios, for many sets of ratios at once."""

import numpy as np
from jaxtyping import Float

Ratios = Float[np.ndarray, "*batch L"]


def by_interpolation(levels: Float[np.ndarray, "L"], ratios: Ratios, criterion: float) -> Float[np.ndarray, "*batch"]:
    """Where the ratio first passes the criterion, on straight lines from level to level.

    Where it never passes from below, minus infinity if it is above at the smallest level, and infinity if it is not.
    """
    below, above = ratios[..., :-1] < criterion, ratios[..., 1:] >= criterion
    passes = below & above
    first = np.argmax(passes, -1)
    low, high = (np.take_along_axis(ratios, first[..., None] + k, -1)[..., 0] for k in (0, 1))
    with np.errstate(invalid="ignore", divide="ignore"):
        share = (criterion - low) / (high - low)
    found = levels[first] + share * (levels[first + 1] - levels[first])
    return np.where(passes.any(-1), found, np.where(ratios[..., 0] >= criterion, -np.inf, np.inf))


def by_line(levels: Float[np.ndarray, "L"], ratios: Ratios, criterion: float) -> Float[np.ndarray, "*batch"]:
    """Where the straight line of least squares passes the criterion; NaN where it does not rise."""
    centred = levels - levels.mean()
    slope = ratios @ centred / (centred @ centred)
    with np.errstate(invalid="ignore", divide="ignore"):
        found = levels.mean() + (criterion - ratios.mean(-1)) / slope
    return np.where(slope > 0, found, np.nan)


def by_line_from_chance(
    levels: Float[np.ndarray, "L"], ratios: Ratios, criterion: float, chance: float
) -> Float[np.ndarray, "*batch"]:
    """As ``by_line``, with chance at level zero as one more point: of many ways, the only one that gives the paper's
    results."""
    at_zero = np.full((*ratios.shape[:-1], 1), chance)
    return by_line(np.concatenate([[0.0], levels]), np.concatenate([at_zero, ratios], -1), criterion)
