"""The threshold of a set of answers: an estimate with an interval, or a statement why there is none."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float
from scipy.special import chdtri

from jaxgrasp.psychophysics.analysis import lines
from jaxgrasp.psychophysics.analysis.bootstrap import Estimator, bca_interval, draw, percentile_interval
from jaxgrasp.psychophysics.analysis.counts import Counts
from jaxgrasp.psychophysics.analysis.finding import Finding, place, trouble
from jaxgrasp.psychophysics.analysis.likelihood import Likelihood, Model, Parameters, focused
from jaxgrasp.validation.checked import checked

Method = Literal["likelihood", "posterior", "interpolation", "line", "paper"]
Interval = Literal["profile", "credible", "bootstrap", "bca", "none"]
DEFAULT_INTERVAL: dict[str, Interval] = {"likelihood": "profile", "posterior": "credible"}
RESAMPLES = 2000
FALLEN = 1e-2
"""Share of a posterior's largest density: where the density at the end of the grid is below it, the answers bound the
threshold."""


@dataclass(frozen=True)
class Threshold:
    """The threshold of one set of answers, with its interval."""

    finding: Finding
    estimate: float
    """As the method has it, wherever it lies; NaN where there is none."""
    low: float
    """Lower end of the interval; 0 where the answers do not bound it."""
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
        """The estimate, if it lies among the levels that were tried; else NaN: nothing is made up."""
        return self.estimate if self.finding is Finding.FOUND else np.nan


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
    """Level at which answers are right as often as the criterion says.

    Args:
        counts: of right answers.
        method: ``"likelihood"`` (its maximum), ``"posterior"`` (its median), ``"interpolation"`` from level to level,
            ``"line"`` of least squares, or ``"paper"``: that line with chance at level zero as one more point.
        model: psychometric function, criterion, chance and lapses; of lines, the criterion and chance alone count.
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
        ValueError: for an interval that the method does not have, or a coverage outside 0 to 1.
    """
    model = Model() if model is None else model
    kind = interval or DEFAULT_INTERVAL.get(method, "bca")
    _check(method, kind, coverage)
    of_grid = method in ("likelihood", "posterior")
    found = trouble(counts, model.chance, needs_levels=not of_grid or model.shape.has_width)
    if found is not Finding.FOUND and (not of_grid or found is Finding.NO_TRIALS or not np.any(counts.levels > 0)):
        return Threshold(found, np.nan, 0.0, np.inf, model.criterion, method, kind, coverage)
    if of_grid:
        return _by_grid(counts, method, model, kind, found, coverage, resamples, seed)
    estimator = _line(method, counts, model)
    estimate = float(estimator(counts.hits[None].astype(float))[0])
    ends = (0.0, np.inf)
    if kind != "none":
        drawn = estimator(draw(counts, counts.ratios, resamples, np.random.default_rng(seed)))
        ends = _drawn_interval(drawn, estimate, counts, estimator, kind, coverage)
    found = place(estimate, counts)
    estimate = estimate if np.isfinite(estimate) else np.nan
    return Threshold(found, estimate, *ends, model.criterion, method, kind, coverage)


def _by_grid(
    counts: Counts, method: str, model: Model, kind: str, found: Finding, coverage: float, resamples: int, seed: int
) -> Threshold:
    """Answers that settle nothing still bound the threshold: they have an interval, and no estimate."""
    grid = focused(counts, model)
    trials = counts.trials.astype(float)
    parameters = grid.best(counts) if method == "likelihood" else None
    estimate = posterior_quantiles(grid, counts, [0.5])[0] if parameters is None else parameters.threshold
    if found is not Finding.FOUND:
        estimate = np.nan
    profile = _profile_interval(grid, counts, coverage)
    if kind == "profile":
        ends = profile
    elif kind == "credible":
        ends = _credible_interval(grid, counts, coverage)
    elif kind == "none" or found is not Finding.FOUND:
        ends = (0.0, np.inf)
    else:
        best = grid.best(counts) if parameters is None else parameters
        chances = model.hit_probability(counts.levels, best)
        estimator: Estimator = lambda hits: grid.estimates(hits, trials)  # noqa: E731
        drawn = estimator(draw(counts, chances, resamples, np.random.default_rng(seed)))
        ends = _drawn_interval(drawn, estimate, counts, estimator, kind, coverage)
    if found is Finding.FOUND:
        # A function without a width is known at zero: there, what is bounded from below needs no smaller level.
        found = place(estimate, counts, from_zero=profile[0] > 0 and not model.shape.has_width)
    return Threshold(found, estimate, *ends, model.criterion, method, kind, coverage, parameters)


def posterior_quantiles(grid: Likelihood, counts: Counts, shares: list[float]) -> list[float]:
    """Quantiles of the threshold's posterior distribution."""
    weights = grid.posteriors(counts.hits, counts.trials)[0]
    # Each point stands for its step, half of it on either side.
    summed = np.cumsum(weights) - 0.5 * weights
    return np.exp(np.interp(shares, summed, np.log(grid.thresholds))).tolist()


def _credible_interval(grid: Likelihood, counts: Counts, coverage: float) -> tuple[float, float]:
    """Interval between quantiles of the posterior; open where it has not fallen off at the grid's end: the prior's."""
    weights = grid.posteriors(counts.hits, counts.trials)[0]
    low, high = posterior_quantiles(grid, counts, [(1 - coverage) / 2, (1 + coverage) / 2])
    falls = weights[[0, -1]] < FALLEN * weights.max()
    return low if falls[0] else 0.0, high if falls[1] else np.inf


def _profile_interval(grid: Likelihood, counts: Counts, coverage: float) -> tuple[float, float]:
    """Thresholds that a likelihood-ratio test does not reject; open where the grid ends before it does."""
    profile = grid.profiles(counts.hits, counts.trials)[0]
    return profile_interval(grid.thresholds, profile, coverage)


def profile_interval(
    thresholds: Float[np.ndarray, "T"], profile: Float[np.ndarray, "T"], coverage: float
) -> tuple[float, float]:
    """Thresholds whose profile log-likelihood is within half a quantile of chi-square of its maximum."""
    margin = profile - profile.max() + 0.5 * chdtri(1, 1 - coverage)
    inside = np.flatnonzero(margin >= 0)
    logs = np.log(thresholds)

    def crossing(k: int) -> float:
        share = margin[k] / (margin[k] - margin[k + 1])
        return float(np.exp(logs[k] + share * (logs[k + 1] - logs[k])))

    low = 0.0 if inside[0] == 0 else crossing(int(inside[0]) - 1)
    high = np.inf if inside[-1] == len(thresholds) - 1 else crossing(int(inside[-1]))
    return low, high


def _drawn_interval(
    drawn: Float[np.ndarray, "B"], estimate: float, counts: Counts, estimator: Estimator, kind: str, coverage: float
) -> tuple[float, float]:
    if kind == "bca" and np.isfinite(estimate):
        low, high = bca_interval(drawn, estimate, counts, estimator, coverage)
    else:
        low, high = percentile_interval(drawn, coverage)
    # Below all levels is as far as such a draw goes.
    return max(low, 0.0), high if high > 0 else float(counts.levels[0])


def _line(method: str, counts: Counts, model: Model) -> Estimator:
    def estimator(hits: Float[np.ndarray, "B L"]) -> Float[np.ndarray, "B"]:
        return line_estimates(method, counts.levels, hits / counts.trials, model)

    return estimator


def line_estimates(
    method: str, levels: Float[np.ndarray, "L"], ratios: Float[np.ndarray, "B L"], model: Model
) -> Float[np.ndarray, "B"]:
    """Thresholds by one of the methods that draw straight lines; NaN where there is none."""
    if method == "interpolation":
        return lines.by_interpolation(levels, ratios, model.criterion)
    if method == "line":
        return lines.by_line(levels, ratios, model.criterion)
    return lines.by_line_from_chance(levels, ratios, model.criterion, model.chance)


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
