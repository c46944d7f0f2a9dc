"""The likelihood of a psychometric function on a grid of its parameters, for many sets of answers at once.

Its threshold is a parameter itself, so that profile likelihood and posterior of the threshold are a maximum and a
sum over the other axes. Sets of answers at the same levels share the grid: one matrix product serves them all.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Float, Real
from scipy.optimize import minimize
from scipy.special import xlogy

from jaxgrasp.psychophysics.analysis.counts import Counts
from jaxgrasp.psychophysics.psychometric import PsychometricShape, check_criterion, hit_probability

Answers = Real[np.ndarray, "... L"]
"""Counts of answers at each level, of one set of answers or of many."""
Bounds = tuple[tuple[float, float], tuple[float, float], tuple[float, float]]
"""Smallest and largest threshold, width, and lapse."""
THRESHOLDS, WIDTHS, LAPSES = 240, 80, 6
"""Points of the grid."""
REACH = (0.05, 5.0)
"""From the smallest level, and from the largest: where thresholds are looked for, by these."""
SPREAD = (0.05, 5.0)
"""Widths by the largest level."""
LOG_SPREAD = (0.1, 5.0)
"""Widths of a Weibull function."""
ROUNDS = 3
"""Times that a grid is narrowed to where its likelihood is: each makes it a hundred times finer, if answers are many
enough."""
NEGLIGIBLE = 15.0
"""Below the largest log-likelihood by this, nothing matters."""
FLOOR = 1e-12
"""Least probability of an answer, so that no logarithm is infinite."""
AT_ONCE = 2**22
"""Numbers of the grid times sets of answers."""


@dataclass(frozen=True)
class Model:
    """Which psychometric function, and what is known of it beforehand."""

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
            raise ValueError(f"lapse is {self.lapse}: expected its least and its largest value")
        check_criterion(self.criterion, self.chance, self.lapse[1])

    def hit_probability(self, levels: np.ndarray, parameters: "Parameters") -> np.ndarray:
        """Chance of a right answer at each level."""
        found = hit_probability(
            self.shape,
            levels,
            parameters.threshold,
            parameters.width,
            parameters.lapse,
            criterion=self.criterion,
            chance=self.chance,
        )
        return np.asarray(found)


@dataclass(frozen=True)
class Parameters:
    """Parameters of one psychometric function."""

    threshold: float
    width: float
    lapse: float


class Likelihood:
    """Likelihood of a model on a grid of its parameters, for answers at given levels."""

    def __init__(self, levels: Float[np.ndarray, "L"], model: Model, bounds: Bounds | None = None) -> None:
        """A grid around levels, of which one at least is positive, or within bounds."""
        self.levels, self.model = np.asarray(levels, float), model
        thresholds, widths, lapses = _bounds(self.levels, model) if bounds is None else bounds
        self.thresholds = np.geomspace(*thresholds, THRESHOLDS)
        self.widths = np.geomspace(*widths, WIDTHS) if model.shape.has_width else np.ones(1)
        self.lapses = np.linspace(*lapses, LAPSES if lapses[1] > lapses[0] else 1)
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
        """Largest log-likelihood at each threshold."""
        return self._reduced(hits, trials, lambda table: table.max((2, 3)))

    def posteriors(self, hits: Answers, trials: Answers) -> Float[np.ndarray, "B T"]:
        """Probability of each threshold, by a prior that is even over the grid.

        That is, even in the logarithms of threshold and width, and over the lapses, within the grid's bounds.
        """

        def over_others(table: np.ndarray) -> np.ndarray:
            top = table.max((1, 2, 3), keepdims=True)
            return np.exp(table - top).sum((2, 3))

        found = self._reduced(hits, trials, over_others)
        return found / found.sum(1, keepdims=True)

    def estimates(self, hits: Answers, trials: Answers) -> Float[np.ndarray, "B"]:
        """Thresholds of largest likelihood, to a small part of the grid's step."""
        return self.peaks(self.profiles(hits, trials))

    def peaks(self, profiles: Float[np.ndarray, "B T"]) -> Float[np.ndarray, "B"]:
        """Where profiles are highest, by a parabola through the highest point and its neighbours."""
        best = np.argmax(profiles, 1)
        inner = np.clip(best, 1, THRESHOLDS - 2)
        rows = np.arange(len(profiles))
        before, here, after = (profiles[rows, inner + k] for k in (-1, 0, 1))
        bend = before - 2 * here + after
        with np.errstate(invalid="ignore", divide="ignore"):
            shift = np.where(bend < 0, 0.5 * (before - after) / bend, 0.0)
        shift = np.where(best == inner, np.clip(shift, -1, 1), 0.0)
        step = np.log(self.thresholds[1] / self.thresholds[0])
        return self.thresholds[best] * np.exp(step * shift)

    def best(self, counts: Counts) -> Parameters:
        """The function of largest likelihood: from the grid's best point on, within the grid's bounds."""
        hits, trials = counts.hits.astype(float), counts.trials.astype(float)
        table = hits @ self._hit + (trials - hits) @ self._miss
        at = np.unravel_index(np.argmax(table), (len(self.thresholds), len(self.widths), len(self.lapses)))
        start = [np.log(self.thresholds[at[0]]), np.log(self.widths[at[1]]), self.lapses[at[2]]]
        ends = [np.log(self.thresholds[[0, -1]]), np.log(self.widths[[0, -1]]), self.model.lapse]

        def loss(values: np.ndarray) -> float:
            here = Parameters(float(np.exp(values[0])), float(np.exp(values[1])), float(values[2]))
            return -log_likelihood(counts, self.model.hit_probability(counts.levels, here))

        options = {"xatol": 1e-7, "fatol": 1e-9, "maxiter": 4000}
        found = minimize(loss, start, method="Nelder-Mead", bounds=ends, options=options).x
        return Parameters(float(np.exp(found[0])), float(np.exp(found[1])), float(found[2]))

    def _reduced(self, hits: Answers, trials: Answers, reduce: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        hits, trials = np.atleast_2d(np.asarray(hits, float)), np.atleast_2d(np.asarray(trials, float))
        hits, trials = np.broadcast_arrays(hits, trials)
        shape = (len(self.thresholds), len(self.widths), len(self.lapses))
        chunk = max(1, AT_ONCE // self._hit.shape[1])
        found = []
        for begin in range(0, len(hits), chunk):
            k, n = hits[begin : begin + chunk], trials[begin : begin + chunk]
            found.append(reduce((k @ self._hit + (n - k) @ self._miss).reshape(-1, *shape)))
        return np.concatenate(found)


def focused(counts: Counts, model: Model) -> Likelihood:
    """A grid that is as fine as one set of answers needs it: where its likelihood is, and nowhere else."""
    grid = Likelihood(counts.levels, model)
    for _ in range(ROUNDS):
        ends = []
        for values, others in ((grid.thresholds, (2, 3)), (grid.widths, (1, 3)), (grid.lapses, (1, 2))):
            profile = grid._reduced(counts.hits, counts.trials, partial(np.max, axis=others))[0]
            inside = np.flatnonzero(profile >= profile.max() - NEGLIGIBLE)
            low, high = values[max(inside[0] - 1, 0)], values[min(inside[-1] + 1, len(values) - 1)]
            ends.append((float(low), float(high)))
        grid = Likelihood(counts.levels, model, (ends[0], ends[1], ends[2]))
    return grid


def _bounds(levels: Float[np.ndarray, "L"], model: Model) -> Bounds:
    positive = levels[levels > 0]
    if not len(positive):
        raise ValueError("no level is above zero")
    largest = float(positive.max())
    widths = LOG_SPREAD if model.shape is PsychometricShape.WEIBULL else (SPREAD[0] * largest, SPREAD[1] * largest)
    return (REACH[0] * float(positive.min()), REACH[1] * largest), widths, model.lapse


def log_likelihood(counts: Counts, chances: Float[np.ndarray, "L"]) -> float:
    """Log-likelihood of answers, without the binomial coefficients."""
    safe = np.clip(chances, FLOOR, 1 - FLOOR)
    return float(np.sum(xlogy(counts.hits, safe) + xlogy(counts.trials - counts.hits, 1 - safe)))
