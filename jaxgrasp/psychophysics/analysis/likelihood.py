"""The likelihood of a psychometric function on a grid of its parameters, for many sets of answers at once.

Its threshold is a parameter itself, so that profile likelihood and posterior of the threshold are a maximum and a
sum over the other axes. Sets of answers at the same levels share the grid: one matrix product serves them all.

The axis of levels on which thresholds are searched, with its first bounds, taken from the spacing of the levels.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Float, Real
from scipy.optimize import minimize
from scipy.special import xlogy

from jaxgrasp.psychophysics.analysis.counts import Counts
from jaxgrasp.psychophysics.psychometric import (
    PsychometricShape,
    Values,
    check_criterion,
    check_levels,
    hit_probability,
)

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


Answers = Real[np.ndarray, "... L"]
"""Counts of answers at each level, of one set of answers or of many."""
Bounds = tuple[Range, Range, Range]
"""Smallest and largest coordinate of the threshold, logarithm of the width, and lapse."""
Points = tuple[int, int, int]
POINTS: Points = (240, 80, 6)
"""Points of a grid: of thresholds, widths, and lapses."""
COARSE: Points = (100, 36, 5)
"""Points of a grid that serves the search of bounds alone."""
NARROWED = 0.8
"""Extent of a bound's range after it is narrowed, by that before: where it is more, the grid is as fine as it gets."""
MOST_ROUNDS = 24
"""Grids at most, those with wider bounds included."""
WIDENINGS = 6
"""Times that one bound is moved out at most, each time by the distance of the two: to 64 times that distance."""
ACTIVE = 6.0
"""Below the largest log-likelihood by less than this, a bound is moved out: intervals of up to 99.9 % end there."""
EQUALLY_OPEN = 0.1
"""Difference of the log-likelihoods at two bounds that are equally open."""
UNCHANGED = 0.01
"""Change of the log-likelihood at a bound that is moved out: where it is less, the answers leave that bound open."""
NEGLIGIBLE = 15.0
"""Below the largest log-likelihood by this, nothing matters."""
EQUAL = 1e-6
"""Difference of log-likelihoods that counts as none."""
FLOOR = 1e-12
"""Least probability of an answer, so that no logarithm is infinite."""
AT_ONCE = 2**22
"""Numbers of the grid times sets of answers."""


@dataclass(frozen=True)
class Model:
    """Psychometric function: shape, criterion, chance and bounds of the lapses."""

    shape: PsychometricShape = PsychometricShape.WEIBULL
    """At chance where the level is zero, as comparisons are."""
    criterion: float = 0.75
    """Hit ratio at the threshold."""
    chance: float = 0.5
    """Hit ratio of who guesses: a half where one of two is chosen."""
    lapse: tuple[float, float] = (0.0, 0.05)
    """Least and largest share of lapses; equal where it is known."""

    def __post_init__(self):
        object.__setattr__(self, "shape", PsychometricShape(self.shape))
        if not 0 <= self.lapse[0] <= self.lapse[1]:
            raise ValueError(f"lapse is {self.lapse}: expected its smallest and largest value, both 0 or more")
        check_criterion(self.criterion, self.chance, self.lapse[1])

    def hit_probability(self, levels: np.ndarray, parameters: "Parameters") -> np.ndarray:
        """Compute the chance of a right answer at each level."""
        probabilities = hit_probability(
            self.shape,
            levels,
            parameters.threshold,
            parameters.width,
            parameters.lapse,
            criterion=self.criterion,
            chance=self.chance,
        )
        return np.asarray(probabilities)


@dataclass(frozen=True)
class Parameters:
    """Parameters of one psychometric function."""

    threshold: float
    width: float
    lapse: float


class Likelihood:
    """Likelihood of a model on a grid of its parameters, for answers at given levels."""

    def __init__(
        self, levels: Float[np.ndarray, "L"], model: Model, bounds: Bounds | None = None, points: Points = POINTS
    ) -> None:
        """Compute the grid around levels, or within bounds.

        Raises:
            ValueError: where the shape starts at zero and a level is negative, or none is positive.
        """
        self.levels, self.model = np.asarray(levels, float), model
        self.axis = axis_of(self.levels, model.shape)
        self.bounds = self._first_bounds() if bounds is None else bounds
        of_thresholds, of_widths, lapses = self.bounds
        self.coordinates = np.linspace(*of_thresholds, points[0])
        """Coordinates of the thresholds on the axis."""
        self.thresholds = self.axis.level(self.coordinates)
        self.widths = np.exp(np.linspace(*of_widths, points[1])) if model.shape.has_width else np.ones(1)
        self.lapses = np.linspace(*lapses, points[2] if lapses[1] > lapses[0] else 1)
        chances = hit_probability(
            model.shape,
            self.levels,
            self.thresholds[:, None, None, None],
            self.widths[:, None, None],
            self.lapses[:, None],
            criterion=model.criterion,
            chance=model.chance,
        )
        flat = np.clip(chances, FLOOR, 1 - FLOOR).reshape(-1, len(self.levels))
        self._hit, self._miss = np.log(flat).T, np.log1p(-flat).T

    def profiles(self, hits: Answers, trials: Answers) -> Float[np.ndarray, "B T"]:
        """Compute the largest log-likelihood at each threshold."""
        return self._reduced(hits, trials, lambda table: table.max((2, 3)))

    def posteriors(self, hits: Answers, trials: Answers) -> Float[np.ndarray, "B T"]:
        """Compute the probability of each threshold, by a prior that is even over the grid.

        That is, even in the logarithm of the threshold for shapes that start at zero and in the threshold itself for
        the others; in the logarithm of the width; and over the lapses; all within the grid's bounds.
        """

        def over_others(table: np.ndarray) -> np.ndarray:
            top = table.max((1, 2, 3), keepdims=True)
            return np.exp(table - top).sum((2, 3))

        densities = self._reduced(hits, trials, over_others) * self.axis.prior(self.coordinates)
        return densities / densities.sum(1, keepdims=True)

    def estimates(self, hits: Answers, trials: Answers) -> Float[np.ndarray, "B"]:
        """Compute the thresholds of largest likelihood, to less than the grid's step."""
        return self.peaks(self.profiles(hits, trials))

    def peaks(self, profiles: Float[np.ndarray, "B T"]) -> Float[np.ndarray, "B"]:
        """Return the thresholds where profiles are highest, by a parabola through that point and its neighbours."""
        best = np.argmax(profiles, 1)
        inner = np.clip(best, 1, len(self.coordinates) - 2)
        rows = np.arange(len(profiles))
        before, centre, after = (profiles[rows, inner + k] for k in (-1, 0, 1))
        # Vertex of the parabola through three points: (y- - y+) / (2 (y- - 2 y0 + y+)) steps from the middle one.
        bend = before - 2 * centre + after
        with np.errstate(invalid="ignore", divide="ignore"):
            shift = np.where(bend < 0, 0.5 * (before - after) / bend, 0.0)
        shift = np.where(best == inner, np.clip(shift, -1, 1), 0.0)
        step = self.coordinates[1] - self.coordinates[0]
        return self.axis.level(self.coordinates[best] + step * shift)

    def best(self, counts: Counts) -> Parameters:
        """Compute the function of largest likelihood: from the grid's best point on, within the grid's bounds."""
        hits, trials = counts.hits.astype(float), counts.trials.astype(float)
        table = (hits @ self._hit + (trials - hits) @ self._miss).reshape(len(self.thresholds), -1)
        # Between two levels that a steep function separates, all thresholds fit alike: the middle one stands for them.
        tied = np.flatnonzero(table.max(1) >= table.max() - EQUAL)
        row = int(tied[len(tied) // 2])
        column = divmod(int(np.argmax(table[row])), len(self.lapses))
        start = [self.coordinates[row], np.log(self.widths[column[0]]), self.lapses[column[1]]]
        ends = [self.coordinates[[0, -1]], np.log(self.widths[[0, -1]]), self.model.lapse]

        def parameters(values: np.ndarray) -> Parameters:
            return Parameters(float(self.axis.level(values[0])), float(np.exp(values[1])), float(values[2]))

        def loss(values: np.ndarray) -> float:
            return -log_likelihood(counts, self.model.hit_probability(counts.levels, parameters(values)))

        options = {"xatol": 1e-7, "fatol": 1e-9, "maxiter": 4000}
        return parameters(minimize(loss, start, method="Nelder-Mead", bounds=ends, options=options).x)

    def _first_bounds(self) -> Bounds:
        thresholds, widths = first_bounds(self.levels, self.model.shape, self.axis)
        of_widths = (float(np.log(widths[0])), float(np.log(widths[1])))
        return thresholds, of_widths if self.model.shape.has_width else (0.0, 0.0), self.model.lapse

    def axis_profiles(self, counts: Counts) -> list[Float[np.ndarray, "..."]]:
        """Return the largest log-likelihood at each threshold, at each width and at each lapse, in this order."""
        return [
            self._reduced(counts.hits, counts.trials, partial(np.max, axis=other_axes))[0]
            for other_axes in ((2, 3), (1, 3), (1, 2))
        ]

    def _reduced(self, hits: Answers, trials: Answers, reduce: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        hits, trials = np.atleast_2d(np.asarray(hits, float)), np.atleast_2d(np.asarray(trials, float))
        hits, trials = np.broadcast_arrays(hits, trials)
        shape = (len(self.thresholds), len(self.widths), len(self.lapses))
        chunk = max(1, AT_ONCE // self._hit.shape[1])
        chunks = []
        for begin in range(0, len(hits), chunk):
            k, n = hits[begin : begin + chunk], trials[begin : begin + chunk]
            chunks.append(reduce((k @ self._hit + (n - k) @ self._miss).reshape(-1, *shape)))
        return np.concatenate(chunks)


def focused(counts: Counts, model: Model) -> Likelihood:
    """Compute a grid that is as fine as one set of answers needs it: where its likelihood is, and nowhere else.

    Bounds of thresholds and widths are moved out as long as the likelihood at them is not negligible and still changes.
    """
    grid, search = Likelihood(counts.levels, model, points=COARSE), _BoundSearch()
    best, largest = None, -np.inf
    for _ in range(MOST_ROUNDS):
        profiles = grid.axis_profiles(counts)
        bounds = search.widened(grid, profiles)
        if bounds is None:
            # Of many answers, all points of a grid may lie beside the peak: the search for it starts from the best.
            if best is None or profiles[0].max() > largest + EQUAL:
                best = grid.best(counts)
                largest = log_likelihood(counts, model.hit_probability(counts.levels, best))
            bounds = _narrowed(grid, profiles, best)
            if all(_extent(new) >= NARROWED * _extent(old) for new, old in zip(bounds, grid.bounds, strict=True)):
                break
            search.forget(grid.bounds, bounds)
        grid = Likelihood(counts.levels, model, bounds, COARSE)
    return Likelihood(counts.levels, model, grid.bounds)


class _BoundSearch:
    """Record of the bounds that were moved out, and of those that the answers leave open."""

    def __init__(self) -> None:
        self._history: dict[tuple[int, int], list[tuple[float, float]]] = {}
        """Bounds before each move, with the log-likelihood at them; by axis and end."""
        self._settled: set[tuple[int, int]] = set()

    def widened(self, grid: Likelihood, profiles: list[np.ndarray]) -> Bounds | None:
        """Return wider bounds, or None where none is active any more."""
        bounds = [list(pair) for pair in grid.bounds]
        for k in range(2 if grid.model.shape.has_width else 1):
            for end in (0, -1):
                if (k, end) not in self._settled:
                    bounds[k][end] = self._moved_bound(grid, k, end, profiles[k])
        widened_bounds = (bounds[0][0], bounds[0][1]), (bounds[1][0], bounds[1][1]), grid.bounds[2]
        return None if widened_bounds == grid.bounds else widened_bounds

    def forget(self, old_bounds: Bounds, new_bounds: Bounds) -> None:
        """Drop the record of bounds that were narrowed: a finer grid may find them active again."""
        for k in range(2):
            for end in (0, -1):
                if old_bounds[k][end] != new_bounds[k][end]:
                    self._history.pop((k, end), None)
                    self._settled.discard((k, end))

    def _moved_bound(self, grid: Likelihood, k: int, end: int, profile: np.ndarray) -> float:
        """Return one bound of axis k: moved out, moved back where that changed nothing, or as it is."""
        bound, at_end, history = grid.bounds[k][end], float(profile[end]), self._history.setdefault((k, end), [])
        if at_end <= profile.max() - ACTIVE:
            return bound
        outward = -1 if end == 0 else 1
        largest = LARGEST_LOG if k == 1 else grid.axis.largest
        if history:
            is_rising = at_end >= profile.max() and at_end > history[-1][1] + EQUAL
            is_unchanged = abs(at_end - history[-1][1]) < UNCHANGED and not is_rising
            is_last = len(history) > WIDENINGS or abs(bound) >= largest
            if is_unchanged or is_last:
                self._settled.add((k, end))
                best = float(np.linspace(*grid.bounds[k], len(profile))[np.argmax(profile)])
                # A narrower range has the finer grid: back to the first bound that the answers leave as open.
                for earlier, value in history:
                    if abs(value - at_end) < EQUALLY_OPEN and outward * (best - earlier) <= 0:
                        return earlier
                return bound
        history.append((bound, at_end))
        return float(np.clip(bound + outward * _extent(grid.bounds[k]), -largest, largest))


def _extent(bounds: Range) -> float:
    return bounds[1] - bounds[0]


def _narrowed(grid: Likelihood, profiles: list[np.ndarray], best: Parameters) -> Bounds:
    """Return bounds about the best function that leave out what is negligible, but for one step."""
    peak = float(grid.axis.coordinate(best.threshold)), float(np.log(best.width)), best.lapse
    ends = []
    for (low, high), profile, at_best in zip(grid.bounds, profiles, peak, strict=True):
        values, step = (
            np.linspace(low, high, len(profile), retstep=True) if len(profile) > 1 else (np.array([low]), 0.0)
        )
        inside = values[profile >= profile.max() - NEGLIGIBLE]
        first, last = min(inside[0], at_best) - step, max(inside[-1], at_best) + step
        ends.append((max(low, float(first)), min(high, float(last))))
    return ends[0], ends[1], ends[2]


def log_likelihood(counts: Counts, chances: Float[np.ndarray, "L"]) -> float:
    """Compute the log-likelihood of answers, without the binomial coefficients."""
    safe = np.clip(chances, FLOOR, 1 - FLOOR)
    return float(np.sum(xlogy(counts.hits, safe) + xlogy(counts.trials - counts.hits, 1 - safe)))
