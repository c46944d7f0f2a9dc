"""Goodness of fit of a psychometric function: its deviance, beside those of answers drawn from it."""

from dataclasses import dataclass

import numpy as np
from scipy.special import xlogy

from jaxgrasp.psychophysics.analysis.bootstrap import draw
from jaxgrasp.psychophysics.analysis.counts import Counts
from jaxgrasp.psychophysics.analysis.likelihood import FLOOR, Likelihood, Model, focused
from jaxgrasp.validation.checked import checked


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
