"""The axis of levels on which thresholds are searched, with its first bounds, taken from the spacing of the levels."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from jaxgrasp.psychophysics.psychometric import PsychometricShape, Values, check_levels

Range = tuple[float, float]
BELOW, ABOVE = float(np.log(20.0)), float(np.log(5.0))
"""Reach of the first search beyond the smallest and the largest level, as logarithms of ratios: of shapes that start
at zero."""
REACH = 1.5
"""Reach of the first search beyond the levels, by their extent: of the other shapes."""
FINE = 60.0
"""Spacings of the levels that the first search spans at most, so that its grid has several points in each."""
WIDEST = 5.0
"""Largest width of the first search: by the extent of the levels, and in logarithms of a Weibull function."""
LARGEST_LOG = 200.0
"""Largest logarithm of a level or a width, of either sign, so that none overflows."""
LARGEST_INVERSE_SINH = 8.0
NARROWEST = 0.1
"""Smallest width of the first search of a Weibull function, unless levels lie closer."""
PER_SPACING = 5.0
"""Smallest distance of two levels, by the smallest width of the first search."""


@dataclass(frozen=True)
class LevelAxis:
    """Coordinates of levels: logarithms for shapes that start at zero; for the others the inverse hyperbolic sine of
    the distance from the middle of the levels in units of half their extent.

    The latter is even among the levels and logarithmic far from them, so that a grid that reaches far stays fine where
    the levels are; neither an offset nor a unit of the levels changes a fit."""

    is_logarithmic: bool
    origin: float
    unit: float

    @property
    def least(self) -> float:
        """Smallest level that there is: 0 or minus infinity, the end of an interval that is open below."""
        return 0.0 if self.is_logarithmic else -np.inf

    def coordinate(self, level: Values) -> Float[np.ndarray, "..."]:
        """Return the coordinates of levels."""
        levels = np.asarray(level, float)
        return np.asarray(np.log(levels) if self.is_logarithmic else np.arcsinh((levels - self.origin) / self.unit))

    def level(self, coordinate: Values) -> Float[np.ndarray, "..."]:
        """Return the levels of coordinates."""
        coordinates = np.asarray(coordinate, float)
        levels = np.exp(coordinates) if self.is_logarithmic else self.origin + self.unit * np.sinh(coordinates)
        return np.asarray(levels)

    def prior(self, coordinate: Values) -> Float[np.ndarray, "..."]:
        """Return the density, but for a factor, of a prior that is even in logarithms of levels or in levels."""
        coordinates = np.asarray(coordinate, float)
        return np.asarray(np.ones_like(coordinates) if self.is_logarithmic else np.cosh(coordinates))

    @property
    def largest(self) -> float:
        """Largest coordinate of either sign that a search goes to: of levels, 1,500 times half their extent."""
        return LARGEST_LOG if self.is_logarithmic else LARGEST_INVERSE_SINH


def axis_of(levels: Float[np.ndarray, "L"], shape: PsychometricShape) -> LevelAxis:
    """Return the axis that suits a shape at these levels.

    Raises:
        ValueError: where a shape that starts at zero has a negative level, or none above zero.
    """
    check_levels(shape, levels, "counts.levels")
    if shape.has_zero:
        if not np.any(levels > 0):
            raise ValueError(f"counts.levels are {levels.tolist()}: the shape {shape.value!r} needs a level above zero")
        return LevelAxis(True, 0.0, 1.0)
    low, high = float(levels.min()), float(levels.max())
    # One level has no extent: its size is the only scale there is.
    return LevelAxis(False, (low + high) / 2, (high - low or abs(low) or 1.0) / 2)


def first_bounds(levels: Float[np.ndarray, "L"], shape: PsychometricShape, axis: LevelAxis) -> tuple[Range, Range]:
    """Return the first search's bounds of the threshold's coordinate, and of the width in the units of the shape."""
    positions = np.unique(np.log(levels[levels > 0]) if axis.is_logarithmic else levels)
    low, high = float(positions[0]), float(positions[-1])
    extent = high - low
    spacing = float(np.diff(positions).min()) if len(positions) > 1 else 0.0
    if not axis.is_logarithmic:
        extent, spacing = extent or 2 * axis.unit, spacing or axis.unit / PER_SPACING
        ends = axis.coordinate(np.array([low - REACH * extent, high + REACH * extent]))
        return (float(ends[0]), float(ends[1])), (spacing / PER_SPACING, WIDEST * extent)
    narrowest = min(NARROWEST, spacing / PER_SPACING) if spacing else NARROWEST
    # Levels far from zero lie close in logarithms: a reach of several times their size would leave them one point.
    share = 1.0
    if shape.has_width and spacing:
        share = min(1.0, max(FINE * spacing - extent, 2 * REACH * extent) / (BELOW + ABOVE))
    return (low - share * BELOW, high + share * ABOVE), (narrowest, WIDEST)
