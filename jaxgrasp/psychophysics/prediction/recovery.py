"""Recovery of known thresholds by an analysis: bias of its estimates and coverage of its intervals."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Real
from scipy.special import chdtri

from jaxgrasp.psychophysics.analysis.bootstrap import percentile_interval
from jaxgrasp.psychophysics.analysis.likelihood import Likelihood, Model
from jaxgrasp.psychophysics.analysis.threshold import line_estimates


@dataclass(frozen=True)
class Recovery:
    """Bias, spread and coverage of one method, over many experiments."""

    bias: float
    """Median of the estimates less the truth, by the truth."""
    spread: float
    """Half the distance between the quantiles that a normal distribution has at one standard deviation, by the
    truth."""
    coverage: float
    """Share of the intervals that hold the truth."""
    outside: float
    """Share of the estimates that lie outside the levels, or are none."""


def by_likelihood(
    hits: Real[np.ndarray, "E L"], trials: int, levels: Float[np.ndarray, "L"], model: Model, truth: float
) -> dict[str, Recovery]:
    """Compute the recovery by largest likelihood with profile intervals, and by the posterior's median, at 95 %."""
    grid = Likelihood(levels, model)
    counts = np.full(len(levels), float(trials))
    truth_coordinate = float(grid.axis.coordinate(truth))
    profiles = grid.profiles(hits, counts)
    at_truth = np.array([np.interp(truth_coordinate, grid.coordinates, profile) for profile in profiles])
    covered = 2 * (profiles.max(1) - at_truth) <= chdtri(1, 0.05)
    recoveries = {"likelihood": summed(grid.peaks(profiles), covered, levels, truth)}
    weights = grid.posteriors(hits, counts)
    below = np.cumsum(weights, 1) - 0.5 * weights
    medians = grid.axis.level(np.array([np.interp(0.5, row, grid.coordinates) for row in below]))
    at_truth = np.array([np.interp(truth_coordinate, grid.coordinates, row) for row in below])
    recoveries["posterior"] = summed(medians, np.abs(at_truth - 0.5) <= 0.475, levels, truth)
    return recoveries


def by_bootstrap(
    hits: Real[np.ndarray, "E L"],
    trials: int,
    levels: Float[np.ndarray, "L"],
    model: Model,
    truth: float,
    method: str,
    resamples: int,
    rng: np.random.Generator,
) -> Recovery:
    """Compute the recovery by a method with percentile intervals of 95 % from answers drawn anew."""
    if method == "likelihood":
        grid, counts = Likelihood(levels, model), np.full(len(levels), float(trials))
        estimator = lambda drawn: grid.estimates(drawn, counts)  # noqa: E731
    else:
        estimator = lambda drawn: line_estimates(method, levels, drawn / trials, model)  # noqa: E731
    estimates = estimator(hits)
    covered = np.zeros(len(hits), bool)
    for k, row in enumerate(hits):
        drawn = estimator(rng.binomial(trials, row / trials, (resamples, len(levels))).astype(float))
        low, high = percentile_interval(drawn, 0.95)
        covered[k] = low <= truth <= high
    return summed(estimates, covered, levels, truth)


def summed(
    estimates: Float[np.ndarray, "E"], covered: np.ndarray, levels: Float[np.ndarray, "L"], truth: float
) -> Recovery:
    """Compute bias, spread and coverage of a method; missing estimates count as infinite."""
    finite_or_inf = np.where(np.isnan(estimates), np.inf, estimates)
    low, middle, high = np.quantile(finite_or_inf, [0.1587, 0.5, 0.8413], method="nearest")
    outside = np.mean(~((finite_or_inf >= levels.min()) & (finite_or_inf <= levels.max())))
    return Recovery(
        float(middle / truth - 1), float((high - low) / (2 * truth)), float(np.mean(covered)), float(outside)
    )
