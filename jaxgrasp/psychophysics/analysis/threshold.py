"""The threshold of a set of answers: an estimate with an interval, or a statement why there is none.

Thresholds by straight lines through hit ratios, for many sets of ratios at once.

Intervals by drawing answers anew.

Goodness of fit of a psychometric function: its deviance, beside those of answers drawn from it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float
from scipy.special import chdtri, ndtr, ndtri, xlogy

from jaxgrasp.psychophysics.analysis.counts import Counts
from jaxgrasp.psychophysics.analysis.finding import Finding, locate, obstacle
from jaxgrasp.psychophysics.analysis.likelihood import FLOOR, Likelihood, Model, Parameters, focused
from jaxgrasp.psychophysics.psychometric import PsychometricShape, check_levels
from jaxgrasp.validation.checked import checked

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


Estimator = Callable[[Float[np.ndarray, "B L"]], Float[np.ndarray, "B"]]
"""Thresholds from hits ``(B, L)``; NaN or infinite where there is none."""


def draw(
    counts: Counts, chances: Float[np.ndarray, "L"], resamples: int, rng: np.random.Generator
) -> Float[np.ndarray, "B L"]:
    """Draw hits ``(B, L)`` of as many trials at the same levels, by the chance at each level."""
    return rng.binomial(counts.trials, np.clip(chances, 0, 1), (resamples, len(counts.levels))).astype(float)


def percentile_interval(estimates: Float[np.ndarray, "B"], coverage: float) -> tuple[float, float]:
    """Compute the interval between two quantiles; resamples without a threshold count as infinite."""
    tail = (1 - coverage) / 2
    low, high = np.quantile(np.where(np.isnan(estimates), np.inf, estimates), [tail, 1 - tail], method="nearest")
    return float(low), float(high)


def bca_interval(
    estimates: Float[np.ndarray, "B"], estimate: float, counts: Counts, estimator: Estimator, coverage: float
) -> tuple[float, float]:
    """Compute the interval with bias and acceleration corrected (Efron 1987), the latter by the jackknife."""
    finite_or_inf = np.where(np.isnan(estimates), np.inf, estimates)
    share = np.clip(
        np.mean(finite_or_inf < estimate) + 0.5 * np.mean(finite_or_inf == estimate),
        1 / len(finite_or_inf),
        1 - 1 / len(finite_or_inf),
    )
    bias = ndtri(share)
    acceleration = _acceleration(counts, estimator)
    ends = []
    for z in ndtri([(1 - coverage) / 2, (1 + coverage) / 2]):
        # z' = z0 + (z0 + z) / (1 - a (z0 + z)); the end is the quantile at Phi(z').
        corrected_z = bias + (bias + z) / (1 - acceleration * (bias + z))
        ends.append(float(np.quantile(finite_or_inf, ndtr(corrected_z), method="nearest")))
    return ends[0], ends[1]


def _acceleration(counts: Counts, estimator: Estimator) -> float:
    """Compute the acceleration by the jackknife: a hit left out lowers a level's ratio, a miss left out raises it."""
    ratios, trials = counts.ratios, counts.trials
    without_hit = (counts.hits - 1) / np.maximum(trials - 1, 1)
    without_miss = counts.hits / np.maximum(trials - 1, 1)
    rows, weights = [], []
    for k in range(len(trials)):
        for ratio_without, weight in ((without_hit[k], counts.hits[k]), (without_miss[k], trials[k] - counts.hits[k])):
            if weight and trials[k] > 1:
                jackknifed = ratios.copy()
                jackknifed[k] = ratio_without
                rows.append(jackknifed * trials)
                weights.append(weight)
    if not rows:
        return 0.0
    values = estimator(np.array(rows))
    is_finite = np.isfinite(values)
    if is_finite.sum() < 2:
        return 0.0
    values, counted = values[is_finite], np.array(weights)[is_finite]
    deviations = np.average(values, weights=counted) - values
    # a = sum d^3 / (6 (sum d^2)^1.5), with d the jackknife's mean less each of its values.
    scale = np.sum(counted * deviations**2) ** 1.5
    return float(np.sum(counted * deviations**3) / (6 * scale)) if scale > 0 else 0.0


@dataclass(frozen=True)
class Goodness:
    """Goodness of a fit by largest likelihood."""

    deviance: float
    """Twice the log-likelihood that the ratios themselves have over the function."""
    p_value: float
    """Share of answers drawn from the function, each fitted anew, whose deviance is as large or larger."""
    residuals: tuple[float, ...]
    """Deviance residual of each level: the root of its part in the deviance, with the sign of ratio less function."""


@checked
def goodness(counts: Counts, model: Model | None = None, *, resamples: int = 1000, seed: int = 0) -> Goodness:
    """Compute how well a model fits the answers at best.

    Raises:
        ValueError: where the shape starts at zero and a level is negative, or none is above zero.
    """
    model = Model() if model is None else model
    # As fine and as wide as the answers need it; answers drawn from their best function lie there too.
    grid = focused(counts, model)
    best = grid.best(counts)
    chances = model.hit_probability(counts.levels, best)
    parts = deviances(counts.hits[None], counts.trials, chances)
    drawn = draw(counts, chances, resamples, np.random.default_rng(seed))
    # Both by the grid, so that its step is in both alike.
    observed_deviance = _least_deviance(grid, counts.hits[None].astype(float), counts.trials)[0]
    drawn_deviances = _least_deviance(grid, drawn, counts.trials)
    p_value = (1 + np.count_nonzero(drawn_deviances >= observed_deviance * (1 - 1e-9))) / (1 + resamples)
    signed = np.sign(counts.ratios - chances) * np.sqrt(np.maximum(parts[0], 0))
    return Goodness(float(parts.sum()), float(p_value), tuple(signed.tolist()))


def deviances(hits: np.ndarray, trials: np.ndarray, chances: np.ndarray) -> np.ndarray:
    """Compute each level's part ``(B, L)`` of the deviance."""
    safe = np.clip(chances, FLOOR, 1 - FLOOR)
    ratios = hits / trials
    return 2 * (_entropy(hits, trials, ratios) - xlogy(hits, safe) - xlogy(trials - hits, 1 - safe))


def _entropy(hits: np.ndarray, trials: np.ndarray, ratios: np.ndarray) -> np.ndarray:
    return xlogy(hits, ratios) + xlogy(trials - hits, 1 - ratios)


def _least_deviance(grid: Likelihood, hits: np.ndarray, trials: np.ndarray) -> np.ndarray:
    best = grid.profiles(hits, trials.astype(float)).max(1)
    return 2 * (_entropy(hits, trials, hits / trials).sum(1) - best)


Method = Literal["likelihood", "posterior", "interpolation", "line", "paper"]
Interval = Literal["profile", "credible", "bootstrap", "bca", "none"]
DEFAULT_INTERVAL: dict[str, Interval] = {"likelihood": "profile", "posterior": "credible"}
RESAMPLES = 2000
ON_RISE = 1e-3
"""Answers at a level, expected on the other side of its step, that show that the function rises there."""
FALLEN = 1e-2
"""Share of a posterior's largest density: where the density at the end of the grid is below it, the answers bound the
threshold."""


@dataclass(frozen=True)
class Threshold:
    """The threshold of one set of answers, with its interval."""

    finding: Finding
    estimate: float
    """Estimate of the method, also outside the levels; NaN where there is none."""
    low: float
    """Lower end of the interval; where the answers do not bound it 0, or minus infinity for a shape that does not start
    at zero."""
    high: float
    """Upper end of the interval; infinite where the answers do not bound it."""
    criterion: float
    """Hit ratio at the threshold."""
    method: str
    interval: str
    coverage: float
    function: Parameters | None = None
    """The psychometric function, of a likelihood."""

    @property
    def value(self) -> float:
        """The estimate, if it lies among the levels that were tried; else NaN: nothing is made up.

        Where the finding is ``STEEPER``, thresholds within the interval fit about equally well.
        """
        return self.estimate if self.finding.has_threshold else np.nan


@checked
def threshold(
    counts: Counts,
    method: Method = "likelihood",
    *,
    model: Model | None = None,
    interval: Interval | None = None,
    coverage: float = 0.95,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> Threshold:
    """Compute the level at which answers are right as often as the criterion says.

    Args:
        counts: of right answers.
        method: ``"likelihood"`` (its maximum), ``"posterior"`` (its median), ``"interpolation"`` from level to level,
            ``"line"`` of least squares, or ``"paper"``: that line with chance at level zero as one more point.
        model: psychometric function, criterion, chance and lapses; of lines, the criterion and chance alone count.
            Levels may be negative or logarithms for the shapes ``"gaussian"`` and ``"logistic"``, logarithms for
            ``"gumbel"`` (Weibull's function of them).
        interval: ``"profile"`` of the likelihood, ``"credible"`` from the posterior, ``"bootstrap"`` or ``"bca"`` of
            any; ``"profile"``, ``"credible"`` and ``"bca"``, as the method has it, where not given.
        coverage: of the interval.
        resamples: of a bootstrap: of the fitted function for a likelihood, of the answers for lines.
        seed: of their draws.

    Returns:
        The threshold in the units of the levels, or a finding that says why there is none.

    Example:
        Half way between 60 % and 90 % of right answers lie 75 %:

        >>> import numpy as np
        >>> from jaxgrasp.psychophysics import Counts, threshold
        >>> counts = Counts(np.array([0.1, 0.2]), np.array([6, 9]), np.array([10, 10]))
        >>> round(threshold(counts, "interpolation").value, 6)
        0.15

    Raises:
        ValueError: for an interval that the method does not have, a coverage outside 0 to 1, or negative levels where
            the shape (Weibull, difference) or the method (``"paper"``) starts at level zero.
    """
    model = Model() if model is None else model
    interval_kind = interval or DEFAULT_INTERVAL.get(method, "bca")
    _check(method, interval_kind, coverage)
    of_grid = method in ("likelihood", "posterior")
    finding = obstacle(counts, model.chance, needs_levels=not of_grid or model.shape.has_width)
    if of_grid or method == "paper":
        # The paper's line starts at chance at level zero, as shapes do that start there.
        of_zero = model.shape if of_grid else PsychometricShape.DIFFERENCE
        check_levels(of_zero, counts.levels, "counts.levels")
    is_signed = not model.shape.has_zero or bool(np.any(counts.levels < 0))
    least = -np.inf if is_signed else 0.0
    says_nothing = finding is Finding.NO_TRIALS or not (is_signed or np.any(counts.levels > 0))
    if finding is not Finding.FOUND and (not of_grid or says_nothing):
        return Threshold(finding, np.nan, least, np.inf, model.criterion, method, interval_kind, coverage)
    if of_grid:
        return _by_grid(counts, method, model, interval_kind, finding, coverage, resamples, seed)
    estimator = _line(method, counts, model)
    estimate = float(estimator(counts.hits[None].astype(float))[0])
    ends = (least, np.inf)
    if interval_kind != "none":
        drawn = estimator(draw(counts, counts.ratios, resamples, np.random.default_rng(seed)))
        ends = _drawn_interval(drawn, estimate, counts, estimator, interval_kind, coverage, least)
    finding = locate(estimate, counts)
    estimate = estimate if np.isfinite(estimate) else np.nan
    return Threshold(finding, estimate, *ends, model.criterion, method, interval_kind, coverage)


def _by_grid(
    counts: Counts,
    method: str,
    model: Model,
    interval_kind: str,
    finding: Finding,
    coverage: float,
    resamples: int,
    seed: int,
) -> Threshold:
    """Compute a threshold and its interval on a grid; answers without an estimate still have an interval."""
    grid = focused(counts, model)
    trials = counts.trials.astype(float)
    parameters = grid.best(counts) if method == "likelihood" else None
    estimate = posterior_quantiles(grid, counts, [0.5])[0] if parameters is None else parameters.threshold
    if finding is not Finding.FOUND:
        estimate = np.nan
    profile = _profile_interval(grid, counts, coverage)
    if interval_kind == "profile":
        ends = profile
    elif interval_kind == "credible":
        ends = _credible_interval(grid, counts, coverage)
    elif interval_kind == "none" or finding is not Finding.FOUND:
        ends = (grid.axis.least, np.inf)
    else:
        best = grid.best(counts) if parameters is None else parameters
        chances = model.hit_probability(counts.levels, best)
        estimator: Estimator = lambda hits: grid.estimates(hits, trials)  # noqa: E731
        drawn = estimator(draw(counts, chances, resamples, np.random.default_rng(seed)))
        ends = _drawn_interval(drawn, estimate, counts, estimator, interval_kind, coverage, grid.axis.least)
    if finding is Finding.FOUND:
        # A function without a width is known at zero: there, what is bounded from below needs no smaller level.
        finding = locate(estimate, counts, from_zero=profile[0] > 0 and not model.shape.has_width)
    if finding is Finding.FOUND and model.shape.has_width:
        finding = _width_finding(model, counts, grid.best(counts) if parameters is None else parameters)
    return Threshold(finding, estimate, *ends, model.criterion, method, interval_kind, coverage, parameters)


def _width_finding(model: Model, counts: Counts, best: Parameters) -> Finding:
    """Tell whether answers bound the width of their function of largest likelihood from below."""
    chances = model.hit_probability(counts.levels, best)
    share = (chances - model.chance) / (1 - model.chance - best.lapse)
    # Two parameters need two levels on the rise: where fewer are, each narrower function fits as well.
    on_rise = counts.trials * np.minimum(share, 1 - share) > ON_RISE
    return Finding.STEEPER if np.count_nonzero(on_rise) < 2 else Finding.FOUND


def posterior_quantiles(grid: Likelihood, counts: Counts, shares: list[float]) -> list[float]:
    """Compute quantiles of the threshold's posterior distribution."""
    weights = grid.posteriors(counts.hits, counts.trials)[0]
    # Each point stands for its step, half of it on either side.
    summed = np.cumsum(weights) - 0.5 * weights
    return grid.axis.level(np.interp(shares, summed, grid.coordinates)).tolist()


def _credible_interval(grid: Likelihood, counts: Counts, coverage: float) -> tuple[float, float]:
    """Compute the interval between quantiles of the posterior; open where the prior sets it at the grid's end."""
    weights = grid.posteriors(counts.hits, counts.trials)[0]
    low, high = posterior_quantiles(grid, counts, [(1 - coverage) / 2, (1 + coverage) / 2])
    falls = weights[[0, -1]] < FALLEN * weights.max()
    return low if falls[0] else grid.axis.least, high if falls[1] else np.inf


def _profile_interval(grid: Likelihood, counts: Counts, coverage: float) -> tuple[float, float]:
    """Return the ends of the thresholds whose profile log-likelihood is within half a quantile of chi-square of its
    maximum; open where the grid ends before."""
    profile = grid.profiles(counts.hits, counts.trials)[0]
    margin = profile - profile.max() + 0.5 * chdtri(1, 1 - coverage)
    inside = np.flatnonzero(margin >= 0)
    coordinates = grid.coordinates

    def crossing(k: int) -> float:
        share = margin[k] / (margin[k] - margin[k + 1])
        return float(grid.axis.level(coordinates[k] + share * (coordinates[k + 1] - coordinates[k])))

    low = grid.axis.least if inside[0] == 0 else crossing(int(inside[0]) - 1)
    high = np.inf if inside[-1] == len(coordinates) - 1 else crossing(int(inside[-1]))
    return low, high


def _drawn_interval(
    drawn: Float[np.ndarray, "B"],
    estimate: float,
    counts: Counts,
    estimator: Estimator,
    interval_kind: str,
    coverage: float,
    least: float,
) -> tuple[float, float]:
    if interval_kind == "bca" and np.isfinite(estimate):
        low, high = bca_interval(drawn, estimate, counts, estimator, coverage)
    else:
        low, high = percentile_interval(drawn, coverage)
    # Below all levels is as far as such a draw goes.
    return max(low, least), high if high > least else float(counts.levels[0])


def _line(method: str, counts: Counts, model: Model) -> Estimator:
    def estimator(hits: Float[np.ndarray, "B L"]) -> Float[np.ndarray, "B"]:
        return line_estimates(method, counts.levels, hits / counts.trials, model)

    return estimator


def line_estimates(
    method: str, levels: Float[np.ndarray, "L"], ratios: Float[np.ndarray, "B L"], model: Model
) -> Float[np.ndarray, "B"]:
    """Compute thresholds by a method of straight lines; NaN where there is none."""
    if method == "interpolation":
        return by_interpolation(levels, ratios, model.criterion)
    if method == "line":
        return by_line(levels, ratios, model.criterion)
    return by_line_from_chance(levels, ratios, model.criterion, model.chance)


def _check(method: str, interval: str, coverage: float) -> None:
    of_method = {
        "likelihood": ("profile", "credible", "bootstrap", "bca", "none"),
        "posterior": ("credible", "none"),
    }
    if method not in ("likelihood", "posterior", "interpolation", "line", "paper"):
        raise ValueError(f"method is {method!r}: expected likelihood, posterior, interpolation, line or paper")
    expected = of_method.get(method, ("bootstrap", "bca", "none"))
    if interval not in expected:
        raise ValueError(f"interval is {interval!r}: expected one of {', '.join(expected)} with method {method!r}")
    if not 0 < coverage < 1:
        raise ValueError(f"coverage is {coverage}: expected more than 0 and less than 1")
